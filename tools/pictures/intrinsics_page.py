"""The page of a lens: its numbers, where the target was seen, what the residuals look like."""

from html import escape

import numpy as np

from trigpoint import __version__
from trigpoint.edge.lens.calibration import Calibration
from trigpoint.edge.lens.calibration_text import (
    advice,
    covered_share,
    held_out_text,
    parameter_names,
    rounded,
)
from trigpoint.geometry.rotation import Array
from trigpoint.tools.pages.frame import html_page, note, row, scrolling, section, table
from trigpoint.tools.pages.svg import circle, drawing, element, line

_SIDE = 400.0
_FIELDS = 12
_FEWEST_IN_FIELD = 3
_ARROW_SHARE = 0.03
_SCATTER_SIGMAS = 4.0


def intrinsics_page(found: Calibration, *, name: str, pictures: int) -> str:
    sigma = found.known.sigma[0]
    known = f" ± {rounded(sigma, sigma)}" if found.has_sigmas else ""
    return html_page(
        f"Lens of {name}",
        _judgement(found),
        _numbers(found),
        _coverage(found),
        _residuals(found),
        _models(found),
        _views(found),
        headline=f"{name}: focal length {rounded(found.camera.fx, sigma)}{known} px",
        lead=_lead(found, pictures),
        footer=f"Trigpoint {__version__}",
    )


def _lead(found: Calibration, pictures: int) -> str:
    camera = found.camera
    return (
        f"{pictures} pictures of {camera.width} × {camera.height}; {len(found.used)} views of the "
        f"target used, {found.looks} of them different, {len(found.rejected)} rejected. "
        f"The model is {camera.model.value}. "
        f"Residuals are {found.fit.rms_px:.2f} px a corner; {100 * covered_share(found):.0f} % of "
        "the picture is covered."
    )


def _judgement(found: Calibration) -> str:
    """What the views leave open, or what would make the lens better known."""
    if found.doubts:
        said = [f"Not determined: {doubt}." for doubt in found.doubts]
    else:
        advised = advice(found)
        said = [f"For a better one: {advised}."] if advised else []
    return "".join(element("p", escape(words)) for words in said)


def _numbers(found: Calibration) -> str:
    names = parameter_names(found.camera.model)
    values = zip(names, found.camera.parameters.tolist(), found.known.sigma.tolist(), strict=True)
    words = (
        "Sigmas are one standard deviation, by the residuals and by how much views that differ "
        "disagree; views that are alike count as one. The coefficients of one lens are "
        "strongly correlated: only together do they mean anything."
    )
    cells = (
        (name, rounded(value, sigma), rounded(sigma, sigma) if found.has_sigmas else "–")
        for name, value, sigma in values
    )
    return section(
        "The lens", note(words), scrolling(table(("", "value", "sigma"), map(row, cells)))
    )


def _coverage(found: Calibration) -> str:
    words = "Where the target's corners were seen. Where none were, the lens is extrapolated."
    return section("Coverage", note(words), _figure(_coverage_drawing(found)))


def _residuals(found: Calibration) -> str:
    words = (
        "Measured minus predicted. A good lens leaves a round cloud and arrows without a pattern; "
        "arrows that turn or point outwards together tell of a model that does not fit."
    )
    ring = f"Every corner; the circles are one and two sigmas ({found.known.noise_px:.3f} px)."
    pair = element(
        "div",
        _figure(_scatter_drawing(found), ring),
        _figure(_field_drawing(found), "Means over the picture, much enlarged."),
        class_="pair",
    )
    return section("Residuals", note(words), pair)


def _models(found: Calibration) -> str:
    words = (
        "Taken is the first that no other beats beyond chance (two standard errors) on views that "
        "the lens was not fitted to."
    )
    cells = (
        (
            one.model.value + (" (taken)" if one.model is found.camera.model else ""),
            f"{one.fit.rms_px:.3f}" if one.fit else "fits none",
            held_out_text(one).removesuffix(" px"),
        )
        for one in found.tried
    )
    head = ("model", "own residuals, px a corner", "views left out, px a coordinate")
    return section("Which model", note(words), scrolling(table(head, map(row, cells))))


def _views(found: Calibration) -> str:
    words = f"Good ones that would have told nothing new and were left out: {found.spare}."
    rows = [
        (view.name, str(len(view)), f"{rms:.3f}", "used")
        for view, rms in zip(found.used, found.fit.view_rms_px.tolist(), strict=True)
    ]
    rows += [(bad.name, "", f"{bad.rms_px:.3f}", "rejected") for bad in found.rejected]
    rows.sort(key=lambda row: -float(row[2]))
    shown = [row((escape(name), *cells)) for name, *cells in rows]
    every = table(("view", "corners", "residual, px a corner", ""), shown)
    summary = element("summary", f"All {len(rows)}, the worst first")
    return section("Views", note(words), element("details", summary, scrolling(every)))


def _figure(shown: str, caption: str = "") -> str:
    below = element("figcaption", escape(caption)) if caption else ""
    return element("figure", shown, below, class_="card")


def _coverage_drawing(found: Calibration) -> str:
    """Every corner in the picture's frame."""
    scale = _SIDE / found.camera.width
    return _framed(found, "where corners were seen", _dots((_pixels(found) + 0.5) * scale))


def _scatter_drawing(found: Calibration) -> str:
    """The cloud of residuals, with circles at one and two sigmas of a coordinate."""
    middle, noise_px = _SIDE / 2, found.known.noise_px
    scale = middle / (_SCATTER_SIGMAS * noise_px)
    cloud = np.clip(_errors(found) * scale, -middle, middle) + middle
    rings = (
        circle(middle, middle, sigmas * noise_px * scale, class_="picture-frame")
        for sigmas in (1, 2)
    )
    return drawing(_SIDE, _SIDE, _dots(cloud), *rings, label="residuals")


def _field_drawing(found: Calibration) -> str:
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
