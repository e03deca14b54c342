"""The page of a lens: its numbers, where the target was seen, what the residuals look like."""

from html import escape

import numpy as np

from trigpoint import __version__
from trigpoint.edge.lens.calibration import Calibration
from trigpoint.edge.lens.calibration_text import (
    advice,
    covered_share,
    held_out_text,
    parameter_rows,
    rounded,
)
from trigpoint.fusion.estimators.residuals import CameraResiduals
from trigpoint.tools.pages.frame import html_page, note, row, scrolling, section, table
from trigpoint.tools.pages.residual_charts import residual_figures
from trigpoint.tools.pages.svg import camera_colour, element


def intrinsics_page(found: Calibration, *, name: str, pictures: int) -> str:
    sigma = found.known.sigma[0]
    known = f" ± {rounded(sigma, sigma)}" if found.has_sigmas else ""
    return html_page(
        f"Lens of {name}",
        _judgement(found),
        _numbers(found),
        _residuals(found, name),
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
    words = (
        "Sigmas are one standard deviation, by the residuals and by how much views that differ "
        "disagree; views that are alike count as one. The coefficients of one lens are "
        "strongly correlated: only together do they mean anything."
    )
    rows = (row((name, value, sigma or "–")) for name, value, sigma in parameter_rows(found))
    return section("The lens", note(words), scrolling(table(("", "value", "sigma"), rows)))


def _residuals(found: Calibration, name: str) -> str:
    words = (
        "Where no corners were seen, the lens is extrapolated. A good lens leaves lines without a "
        "pattern; such as turn or point outwards together tell of a model that does not fit. A "
        f"coordinate's sigma is {found.known.noise_px:.3f} px, by the residuals themselves."
    )
    pixels = np.concatenate([view.pixels for view in found.used])
    errors = np.concatenate(found.fit.errors)
    sigma_px = np.full(len(pixels), found.known.noise_px)
    residuals = CameraResiduals(
        np.zeros((0, 3)), pixels, -errors, sigma_px, np.ones(len(pixels), dtype=bool)
    )
    size = found.camera.width, found.camera.height
    drawn = residual_figures(residuals, *size, name=name)
    return section(
        "Coverage and residuals",
        note(words),
        element("div", drawn, class_=f"card {camera_colour(0)}"),
    )


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
