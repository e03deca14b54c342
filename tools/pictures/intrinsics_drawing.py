"""Drawings of a lens calibration: where corners were seen, and what the fit leaves of them."""

import numpy as np

from trigpoint.edge.lens.calibration import Calibration
from trigpoint.geometry.rotation import Array
from trigpoint.tools.pages.svg import circle, drawing, element, line

_SIDE = 400.0
_FIELDS = 12
_FEWEST_IN_FIELD = 3
_ARROW_SHARE = 0.03
_SCATTER_SIGMAS = 4.0


def coverage_drawing(found: Calibration) -> str:
    """Every corner in the picture's frame."""
    scale = _SIDE / found.camera.width
    return _framed(found, "where corners were seen", _dots((_pixels(found) + 0.5) * scale))


def scatter_drawing(found: Calibration) -> str:
    """The cloud of residuals, with circles at one and two sigmas of a coordinate."""
    middle, noise_px = _SIDE / 2, found.known.noise_px
    scale = middle / (_SCATTER_SIGMAS * noise_px)
    cloud = np.clip(_errors(found) * scale, -middle, middle) + middle
    rings = (
        circle(middle, middle, sigmas * noise_px * scale, class_="picture-frame")
        for sigmas in (1, 2)
    )
    return drawing(_SIDE, _SIDE, _dots(cloud), *rings, label="residuals")


def field_drawing(found: Calibration) -> str:
    """Mean residuals in square fields of the picture, as arrows from the fields' middles."""
    side = found.camera.width / _FIELDS
    fields = np.floor((_pixels(found) + 0.5) / side).astype(int)
    errors = _errors(found)
    scale = _SIDE / found.camera.width
    enlarged = _ARROW_SHARE * _SIDE / found.known.noise_px
    arrows = []
    for field in np.unique(fields, axis=0):
        own = np.all(fields == field, axis=1)
        if own.sum() >= _FEWEST_IN_FIELD:
            (x, y), (u, v) = (field + 0.5) * side * scale, errors[own].mean(axis=0) * enlarged
            arrows += [circle(x, y, 1.8, class_="dot"), line(x, y, x + u, y + v, class_="arrow")]
    return _framed(found, "mean residuals over the picture", *arrows)


def _pixels(found: Calibration) -> Array:
    return np.concatenate([view.pixels for view in found.used])


def _errors(found: Calibration) -> Array:
    return np.concatenate(found.fit.errors)


def _framed(found: Calibration, label: str, *content: str) -> str:
    height = _SIDE * found.camera.height / found.camera.width
    frame = element("rect", width=_SIDE, height=height, class_="picture-frame")
    return drawing(_SIDE, height, *content, frame, label=label)


def _dots(points: Array) -> str:
    """Many points as one path, (n, 2)."""
    way = "".join(f"M{x:.1f} {y:.1f}h0" for x, y in points)
    return element("path", d=way, class_="dots")
