"""The page's section on how well robots would be corrected where they drove."""

from collections.abc import Iterator
from html import escape

import numpy as np

from trigpoint.fusion.coverage.accuracy_map import BY_FAILURE_M, WITHIN_M, AccuracyMap, class_name
from trigpoint.geometry.rotation import Array
from trigpoint.tools.pages.floor_plan import picture_on_map
from trigpoint.tools.pages.frame import (
    legend,
    note,
    row,
    scrolling,
    section,
    table,
    wide_and_upright,
)
from trigpoint.tools.pages.network_map import UPRIGHT, WIDE
from trigpoint.tools.pages.plan import Plan
from trigpoint.tools.pages.svg import camera_colour, circle, drawing, element, group, text

from .facts import CalibrationResults

_COLOURS = ("#1a7f5a", "#63b179", "#d9c45b", "#e39a4b", "#c96f4a", "#a2313a")
"""Of the classes, and of where a robot is not corrected."""


def corrected_section(results: CalibrationResults) -> str:
    """Maps and tables; "" where nothing is known."""
    parts = [_of(results, each) for each in results.corrected if each.is_floor.any()]
    if not parts:
        return ""
    words = (
        "On the floor within half a metre of where robots drove: the radius within which 95 % of "
        "the errors of a robot's position lie after one picture by every camera that sees it, by "
        "the joint covariance, in more than half of eight headings. Walls are not known."
    )
    return section("How well a robot is corrected", note(words), *parts)


def _of(results: CalibrationResults, each: AccuracyMap) -> str:
    who = [element("h3", escape(", ".join(each.robots)))] if len(results.corrected) > 1 else []
    wide = _drawing(results, each, WIDE, upright=False)
    upright = _drawing(results, each, UPRIGHT, upright=True)
    figure = wide_and_upright(wide, upright, legend(_meanings(each)))
    return element("div", *who, figure, scrolling(_losses(each)))


def _drawing(results: CalibrationResults, each: AccuracyMap, width: float, *, upright: bool) -> str:
    floor = each.floor
    x, y = floor.origin
    right, top = x + floor.columns * floor.cell_m, y + floor.rows * floor.cell_m
    corners = np.array([[x, y], [right, y], [right, top], [x, top]])
    places = {
        name: record.pose.translation[:2]
        for name in each.names
        if (record := results.network.cameras[name].map_from_camera) is not None
    }
    plan = Plan(np.vstack([corners, *places.values()]), width, upright=upright)
    numbers = {name: index for index, name in enumerate(results.network.cameras)}
    marks = [_camera(name, plan(place), numbers[name]) for name, place in places.items()]
    picture = picture_on_map(_pixels(each), corners, plan, class_="corrected-floor")
    label = "Map from above of how well a robot would be corrected where"
    return drawing(plan.width, plan.height, picture, *marks, label=label, class_="map")


def _camera(name: str, place: Array, index: int) -> str:
    x, y = (float(value) for value in place)
    mark = circle(x, y, 4.0, class_="found")
    return group(mark, text(x, y - 8, name, class_="name"), class_=camera_colour(index))


def _classes(each: AccuracyMap) -> np.ndarray:
    """The class of each cell: an index into WITHIN_M, or one beyond where it is not corrected."""
    errors = each.error_m
    finite = np.searchsorted(np.array(WITHIN_M[:-1]), errors, side="left")
    return np.where(np.isfinite(errors), finite, len(WITHIN_M))


def _pixels(each: AccuracyMap) -> np.ndarray:
    floor = each.floor
    pixels = np.zeros((floor.rows * floor.columns, 4), dtype=np.uint8)
    colours = [tuple(bytes.fromhex(colour[1:])) for colour in _COLOURS]
    pixels[:, :3] = np.array(colours)[_classes(each)]
    pixels[:, 3] = np.where(each.is_floor, 255, 0)
    return pixels.reshape(floor.rows, floor.columns, 4)[::-1]


def _meanings(each: AccuracyMap) -> Iterator[tuple[str, str]]:
    """Each colour, and how much of the floor has it."""
    sizes = [each.area_m2(within_m) for within_m in WITHIN_M]
    names = [class_name(w) for w in WITHIN_M[:-1]]
    names += [f"beyond {100 * WITHIN_M[-2]:g} cm", "not corrected"]
    shown = np.diff([0.0, *sizes, each.floor_m2])
    for colour, name, area in zip(_COLOURS, names, shown, strict=True):
        box = element("rect", x=4, y=1, width=26, height=12, fill=colour, class_="corrected-floor")
        yield box, f"{name}: {area:.1f} m²"


def _losses(each: AccuracyMap) -> str:
    """What each camera's failure costs."""
    head = ["camera", "sees m²"]
    head += [f"lost without it,<br>{class_name(w)}, m²" for w in BY_FAILURE_M]
    rows = (
        row((escape(name), *(f"{area:.1f}" for area in areas)))
        for name, areas in each.failures_m2()
    )
    return table(head, rows)
