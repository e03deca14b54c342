"""The page of a lens: its numbers, where the target was seen, what the residuals look like."""

from collections.abc import Iterable
from xml.etree.ElementTree import Element, tostring

from trigpoint import __version__
from trigpoint.edge.lens.calibration import Calibration
from trigpoint.edge.lens.calibration_text import (
    advice,
    covered_share,
    held_out_text,
    parameter_names,
    rounded,
)

from .intrinsics_drawing import coverage_drawing, element, field_drawing, scatter_drawing

_STYLE = """
:root { --paper:#fbfaf7; --card:#fff; --ink:#1c2024; --soft:#5b636b; --rule:#e3e1da; --bar:#2563a8;
  --arrow:#cf4a32; color-scheme:light }
@media screen and (prefers-color-scheme: dark) {
  :root { --paper:#14171a; --card:#1b1f23; --ink:#e8eaec; --soft:#a4acb4; --rule:#2c3238;
    --bar:#7db4f0; --arrow:#ff8a70; color-scheme:dark }
}
body { margin:0; background:var(--paper); color:var(--ink); font:16px/1.5 system-ui,sans-serif;
  font-variant-numeric:tabular-nums }
main { max-width:900px; margin:0 auto; padding:36px 20px 60px }
h1 { font-size:30px; line-height:1.2; margin:0 0 10px }
h2 { font-size:21px; margin:44px 0 4px }
p { max-width:44em; margin:0 0 12px; color:var(--soft) }
figure { margin:0; background:var(--card); border:1px solid var(--rule); border-radius:10px;
  padding:14px }
figcaption { font-size:14px; color:var(--soft); margin-top:8px }
.pair { display:grid; grid-template-columns:repeat(auto-fit,minmax(300px,1fr)); gap:14px }
svg { display:block; width:100%; height:auto; overflow:visible }
svg text { fill:var(--soft); font-size:12px }
.dots { stroke:var(--bar); stroke-width:3; stroke-linecap:round; fill:none; stroke-opacity:.45 }
.frame { fill:none; stroke:var(--soft); stroke-width:1 }
.field { fill:var(--bar) }
.arrow { stroke:var(--arrow); stroke-width:1.6 }
table { border-collapse:collapse; font-size:15px; min-width:50% }
th, td { text-align:right; padding:6px 14px; border-bottom:1px solid var(--rule) }
th { color:var(--soft); font-weight:500 }
th:first-child, td:first-child { text-align:left; padding-left:2px }
summary { cursor:pointer; color:var(--soft) }
footer { margin-top:48px; color:var(--soft); font-size:14px }
"""


def intrinsics_page(found: Calibration, *, name: str, pictures: int) -> str:
    """The whole page, self-contained: no script, no picture, no font from anywhere."""
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("title", f"Lens of {name}"),
        element("style", _STYLE),
    )
    main = element(
        "main",
        *_introduction(found, name, pictures),
        _numbers(found),
        _coverage(found),
        _residuals(found),
        _models(found),
        _views(found),
        element("footer", f"Trigpoint {__version__}"),
    )
    page = element("html", head, element("body", main), lang="en")
    return f"<!doctype html>\n{tostring(page, encoding='unicode', method='html')}\n"


def _introduction(found: Calibration, name: str, pictures: int) -> list[Element]:
    camera, sigma = found.camera, found.known.sigma[0]
    known = f" ± {rounded(sigma, sigma)}" if found.has_sigmas else ""
    title = f"{name}: focal length {rounded(camera.fx, sigma)}{known} px"
    lead = (
        f"{pictures} pictures of {camera.width} × {camera.height}; {len(found.used)} views of the "
        f"target used, {found.looks} of them different, {len(found.rejected)} rejected. "
        f"The model is {camera.model.value}. "
        f"Residuals are {found.fit.rms_px:.2f} px a corner; {100 * covered_share(found):.0f} % of "
        "the picture is covered."
    )
    if found.doubts:
        said = [element("p", f"Not determined: {doubt}.") for doubt in found.doubts]
        return [element("h1", title), element("p", lead), *said]
    advised = advice(found)
    more = [element("p", f"For a better one: {advised}.")] if advised else []
    return [element("h1", title), element("p", lead), *more]


def _numbers(found: Calibration) -> Element:
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
    return _section("The lens", words, _table(("", "value", "sigma"), cells))


def _coverage(found: Calibration) -> Element:
    words = "Where the target's corners were seen. Where none were, the lens is extrapolated."
    return _section("Coverage", words, _figure(coverage_drawing(found)))


def _residuals(found: Calibration) -> Element:
    words = (
        "Measured minus predicted. A good lens leaves a round cloud and arrows without a pattern; "
        "arrows that turn or point outwards together tell of a model that does not fit."
    )
    ring = f"Every corner; the circles are one and two sigmas ({found.known.noise_px:.3f} px)."
    pair = element(
        "div",
        _figure(scatter_drawing(found), ring),
        _figure(field_drawing(found), "Means over the picture, much enlarged."),
        **{"class": "pair"},
    )
    return _section("Residuals", words, pair)


def _models(found: Calibration) -> Element:
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
    return _section("Which model", words, _table(head, cells))


def _views(found: Calibration) -> Element:
    words = f"Good ones that would have told nothing new and were left out: {found.spare}."
    rows = [
        (view.name, str(len(view)), f"{rms:.3f}", "used")
        for view, rms in zip(found.used, found.fit.view_rms_px.tolist(), strict=True)
    ]
    rows += [(bad.name, "", f"{bad.rms_px:.3f}", "rejected") for bad in found.rejected]
    rows.sort(key=lambda row: -float(row[2]))
    table = _table(("view", "corners", "residual, px a corner", ""), rows)
    summary = element("summary", f"All {len(rows)}, the worst first")
    return _section("Views", words, element("details", summary, table))


def _section(title: str, words: str, *content: Element) -> Element:
    return element("section", element("h2", title), element("p", words), *content)


def _figure(drawing: Element, caption: str = "") -> Element:
    return element("figure", drawing, *([element("figcaption", caption)] if caption else []))


def _table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> Element:
    def row(tag: str, cells: Iterable[str]) -> Element:
        return element("tr", *(element(tag, cell) for cell in cells))

    body = element("tbody", *(row("td", cells) for cells in rows))
    return element("table", element("thead", row("th", head)), body)
