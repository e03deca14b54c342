"""Drawings of a lens calibration: where corners were seen, and what the fit leaves of them."""

from xml.etree.ElementTree import Element

import numpy as np

from trigpoint.edge.lens.calibration import Calibration
from trigpoint.geometry.rotation import Array

_SIDE = 400.0
_FIELDS = 12
_FEWEST_IN_FIELD = 3
_ARROW_SHARE = 0.03
_SCATTER_SIGMAS = 4.0


def element(tag: str, *content: "Element | str", **attributes: str) -> Element:
    """An element of a page; text only before the first child."""
    made = Element(tag, attributes)
    for item in content:
        if isinstance(item, str):
            made.text = (made.text or "") + item
        else:
            made.append(item)
    return made


def coverage_drawing(found: Calibration) -> Element:
    """Every corner in the picture's frame."""
    scale = _SIDE / found.camera.width
    return _drawing(found, "where corners were seen", _dots((_pixels(found) + 0.5) * scale))


def scatter_drawing(found: Calibration) -> Element:
    """The cloud of residuals, with circles at one and two sigmas of a coordinate."""
    scale = _SIDE / (2 * _SCATTER_SIGMAS * found.known.noise_px)
    cloud = np.clip(_errors(found) * scale, -_SIDE / 2, _SIDE / 2) + _SIDE / 2
    middle = str(_SIDE / 2)
    rings = (
        element("circle", cx=middle, cy=middle, r=f"{radius:.1f}", **{"class": "frame"})
        for radius in (found.known.noise_px * scale, 2 * found.known.noise_px * scale)
    )
    return _svg(_SIDE, "residuals", _dots(cloud), *rings)


def field_drawing(found: Calibration) -> Element:
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
            arrows += _arrow((field + 0.5) * side * scale, errors[own].mean(axis=0) * enlarged)
    return _drawing(found, "mean residuals over the picture", *arrows)


def _arrow(start: Array, way: Array) -> list[Element]:
    (x, y), (u, v) = start.tolist(), (start + way).tolist()
    ends = {"x1": f"{x:.1f}", "y1": f"{y:.1f}", "x2": f"{u:.1f}", "y2": f"{v:.1f}"}
    return [
        element("circle", cx=f"{x:.1f}", cy=f"{y:.1f}", r="1.8", **{"class": "field"}),
        element("line", **ends, **{"class": "arrow"}),
    ]


def _pixels(found: Calibration) -> Array:
    return np.concatenate([view.pixels for view in found.used])


def _errors(found: Calibration) -> Array:
    return np.concatenate(found.fit.errors)


def _drawing(found: Calibration, label: str, *content: Element) -> Element:
    """A drawing in the picture's frame."""
    height = _SIDE * found.camera.height / found.camera.width
    size = {"width": str(_SIDE), "height": f"{height:.1f}"}
    return _svg(height, label, *content, element("rect", **size, **{"class": "frame"}))


def _svg(height: float, label: str, *content: Element) -> Element:
    box = {"viewBox": f"0 0 {_SIDE:.0f} {height:.1f}", "role": "img", "aria-label": label}
    return element("svg", *content, **box)


def _dots(points: Array) -> Element:
    """Many points as one path, (n, 2)."""
    way = "".join(f"M{x:.1f} {y:.1f}h0" for x, y in points)
    return element("path", d=way, **{"class": "dots"})
