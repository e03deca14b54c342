"""The map of a calibration from above: cameras with ellipses, ways, and where to go next."""

import numpy as np

from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.map.network import AlternativeRecord, CameraRecord
from trigpoint.tools.report.drawing.floor_plan import floor_plan_image
from trigpoint.tools.report.drawing.plan import MARGIN, Plan, suggestion_marks
from trigpoint.tools.report.drawing.style import PALETTE
from trigpoint.tools.report.drawing.svg import (
    circle,
    drawing,
    element,
    ellipse_points,
    group,
    line,
    polygon,
    polyline,
    text,
)

from .facts import CalibrationResults

_VIEW_M = 1.15
_NICE = (1, 2, 5, 10, 20, 50, 100, 200, 500)
_LARGEST_ELLIPSE = 30.0
_MOST_POINTS = 600
_ROOM_M = 0.35
_WALLS_M = 1.5
"""More room where a floor plan lies under the map, so that the walls around are on it."""


def has_map(results: CalibrationResults) -> bool:
    """Whether there is anything to draw."""
    return bool(results.trajectories or results.network.located)


def plan_of(results: CalibrationResults, width: float, *, upright: bool) -> Plan:
    """The drawing that holds cameras, ways and suggestions."""
    points = [poses.translation[:, :2] for _, poses in results.trajectories.values()]
    points += [_wedge(pose) for pose in _poses(results).values()]
    points += [
        _wedge(each.map_from_camera.pose)
        for camera in results.network.cameras.values()
        for each in camera.alternatives
    ]
    points += [s.map_from_base.translation[None, :2] for s in results.suggestions]
    every = np.concatenate(points)
    has_walls = results.building is not None and results.building.plan is not None
    room = _WALLS_M if has_walls else _ROOM_M
    low, high = every.min(axis=0) - room, every.max(axis=0) + room
    return Plan(np.stack([low, high]), width, upright=upright)


def magnification(results: CalibrationResults, plan: Plan) -> int:
    """How many times larger than the map ellipses are drawn, so that they show."""
    located = [results.network.cameras[name] for name in results.network.located]
    sizes = [np.sqrt(np.linalg.eigvalsh(c.covariance_matrix[:2, :2])[-1]) for c in located]
    largest = float(max(sizes, default=0.0)) * plan.scale
    fitting = [factor for factor in _NICE if factor * largest <= _LARGEST_ELLIPSE]
    return fitting[-1] if fitting else 1


def map_drawing(results: CalibrationResults, *, width: float, upright: bool) -> str:
    """The whole map."""
    plan = plan_of(results, width, upright=upright)
    factor = magnification(results, plan)
    parts = [floor_plan_image(results.building, plan)] if results.building else []
    parts += [_way(poses, plan) for _, poses in results.trajectories.values() if len(poses)]
    for index, (name, camera) in enumerate(results.network.cameras.items()):
        if camera.map_from_camera is not None and camera.covariance is not None:
            parts.append(_camera(name, camera, index, plan, factor))
        parts += [_alternative(name, each, index, plan) for each in camera.alternatives]
    parts += suggestion_marks([s.map_from_base for s in results.suggestions], plan)
    parts.append(_scale_bar(plan))
    label = "Map from above with the cameras, their uncertainty and the robots' ways"
    return drawing(plan.width, plan.height + 22, *parts, label=label, class_="map")


def legend(results: CalibrationResults, factor: int) -> str:
    """What the marks on the map mean, as a list."""
    larger = f", drawn {factor} times larger" if factor > 1 else ""
    place = element("ellipse", cx=17, cy=7, rx=14, ry=6, class_="ellipse")
    place += circle(17, 7, 2.6, class_="found")
    entries = [
        _entry(polyline(np.array([[2.0, 7.0], [32.0, 7.0]]), class_="way corrected"),
               "a robot's way, from the ring to the arrow"),
        _entry(place, f"a camera with its standard deviation{larger}; the wedge: where it looks"),
    ]  # fmt: skip
    if any(camera.alternatives for camera in results.network.cameras.values()):
        hollow = circle(17, 7, 5, class_="outline")
        entries.append(_entry(hollow, "where an undetermined camera may be, one of several places"))
    if results.suggestions:
        entries.append(_entry(circle(17, 7, 6, class_="next"), "where to go next, in this order"))
    return element("ul", *entries, class_="legend")


def _poses(results: CalibrationResults) -> dict[str, Pose]:
    records = {n: results.network.cameras[n].map_from_camera for n in results.network.located}
    return {name: record.pose for name, record in records.items() if record is not None}


def _wedge(map_from_camera: Pose) -> Array:
    """Which way a camera looks, (n, 2) metres."""
    eye, forward = map_from_camera.translation[:2], map_from_camera.rotation[:2, 2]
    angles = np.arctan2(forward[1], forward[0]) + np.radians(np.linspace(-30, 30, 13))
    rim = eye + _VIEW_M * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return np.vstack([eye, rim])


def _camera(name: str, camera: CameraRecord, index: int, plan: Plan, factor: int) -> str:
    assert camera.map_from_camera is not None
    pose = camera.map_from_camera.pose
    outline = ellipse_points(
        pose.translation[:2], factor**2 * camera.covariance_matrix[:2, :2], 1.0
    )
    wedge = _wedge(pose)
    x, y = plan(pose.translation[:2])
    towards = wedge[1:].mean(axis=0) - wedge[0]
    label_x, label_y = plan(wedge[0] + 0.62 * towards)
    return group(
        element("title", name),
        polygon(plan(wedge), class_="view"),
        polygon(plan(outline), class_="ellipse"),
        circle(x, y, 2.6, class_="found"),
        text(label_x, label_y + 5, name, class_="name"),
        class_=f"k{index % PALETTE}",
    )


def _alternative(name: str, place: AlternativeRecord, index: int, plan: Plan) -> str:
    """A place that is left open for a camera: hollow, with a question mark."""
    wedge = _wedge(place.map_from_camera.pose)
    x, y = plan(wedge[0])
    label_x, label_y = plan(0.5 * (wedge[0] + wedge[1:].mean(axis=0)))
    return group(
        element("title", f"{name}, {100 * place.probability:.1f} %"),
        polygon(plan(wedge), class_="outline"),
        circle(x, y, 4.5, class_="outline"),
        text(label_x, label_y + 5, f"{name}?", class_="name"),
        class_=f"k{index % PALETTE}",
    )


def _way(poses: Pose, plan: Plan) -> str:
    places = poses.translation[:, :2]
    step = max(1, len(places) // _MOST_POINTS)
    points = np.concatenate([places[::step], places[-1:]])
    x, y = plan(places[0])
    start = circle(x, y, 4.5, class_="start")
    return polyline(plan(points), class_="way corrected") + start + _arrow(poses[-1], plan, "end")


def _arrow(map_from_base: Pose, plan: Plan, kind: str) -> str:
    """A robot's pose, as large in every drawing."""
    unit = 7.0 / plan.scale
    outline = np.array([[1.6, 0.0], [-1.0, 1.1], [-0.4, 0.0], [-1.0, -1.1]]) * unit
    turned = outline @ map_from_base.rotation[:2, :2].T
    return polygon(plan(map_from_base.translation[:2] + turned), class_=kind)


def _scale_bar(plan: Plan) -> str:
    y = plan.height + 6
    bar = line(MARGIN, y, MARGIN + plan.scale, y) + line(MARGIN, y - 4, MARGIN, y + 4)
    bar += line(MARGIN + plan.scale, y - 4, MARGIN + plan.scale, y + 4)
    return group(bar, text(MARGIN + plan.scale + 8, y + 4.5, "1 m"), class_="scale")


def _entry(mark: str, words: str) -> str:
    sample = element("svg", mark, viewBox="0 0 34 14", aria_hidden="true", class_="k0")
    return element("li", sample, element("span", words))
