"""The map of a run from above: walls, cameras, where they were found, and the robot's ways."""

import numpy as np

from trigpoint.geometry.rotation import Array
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

from .results import CameraResult, DemoResults, Track

_NEXT = "where it was last told to go next, to improve the worst camera most"
_VIEW_M = 1.15
_NICE = (1, 2, 5, 10, 20, 50, 100, 200, 500)
_LARGEST_ELLIPSE = 30.0
_MOST_POINTS = 500


def plan_of(results: DemoResults, width: float, *, upright: bool) -> Plan:
    """The drawing that holds walls, cameras and ways."""
    return Plan(_everything(results), width, upright=upright)


def magnification(results: DemoResults, plan: Plan) -> int:
    """How many times larger than the rooms errors and ellipses are drawn, so that they show."""
    sizes = [
        max(np.sqrt(np.linalg.eigvalsh(camera.covariance[:2, :2])[-1]), camera.error.position)
        for camera in results.cameras
        if camera.covariance is not None and camera.error is not None
    ]
    largest = max(sizes, default=0.0) * plan.scale
    fitting = [factor for factor in _NICE if factor * largest <= _LARGEST_ELLIPSE]
    return fitting[-1] if fitting else 1


def map_drawing(results: DemoResults, *, width: float, upright: bool) -> str:
    """The whole map; the ellipses are those of `magnification`."""
    plan = plan_of(results, width, upright=upright)
    factor = magnification(results, plan)
    parts = [_walls(results, plan)]
    parts += [_view(camera, index, plan) for index, camera in enumerate(results.cameras)]
    for robot in results.robots:
        parts.append(_way(robot.truth, plan, "way true"))
        parts.append(_way(robot.odometry, plan, "way reckoned"))
        parts.append(_way(robot.live, plan, "way corrected"))
        parts.append(_ends(robot.truth, plan))
        if robot.suggestion is not None:
            parts += suggestion_marks([robot.suggestion], plan, are_numbered=False)
    parts += [_found(camera, index, plan, factor) for index, camera in enumerate(results.cameras)]
    parts.append(_scale_bar(plan))
    label = "Map of the rooms from above with the cameras and the robot's ways"
    return drawing(plan.width, plan.height + 22, *parts, label=label, class_="map")


def _everything(results: DemoResults) -> Array:
    points = [results.walls.reshape(-1, 2)]
    points += [camera.truth.translation[None, :2] for camera in results.cameras]
    points += [robot.truth.places for robot in results.robots]
    return np.concatenate(points)


def _walls(results: DemoResults, plan: Plan) -> str:
    ends = plan(results.walls)
    return group(
        *(line(*start.tolist(), *end.tolist()) for start, end in ends),
        class_="walls",
    )


def _view(camera: CameraResult, index: int, plan: Plan) -> str:
    """Which way the camera truly looks: a wedge on the floor."""
    eye, forward = camera.truth.translation[:2], camera.truth.rotation[:2, 2]
    direction = np.arctan2(forward[1], forward[0])
    angles = direction + np.radians(np.linspace(-30, 30, 13))
    rim = eye + _VIEW_M * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    wedge = polygon(plan(np.vstack([eye, rim])), class_="view")
    return group(wedge, class_=f"k{index % PALETTE}")


def _found(camera: CameraResult, index: int, plan: Plan, factor: int) -> str:
    """The true place as a ring, what was found as a point with its ellipse, the name beside."""
    true = camera.truth.translation[:2]
    x, y = plan(true)
    marks = [circle(x, y, 5, class_="true-place")]
    if camera.estimate is not None and camera.covariance is not None:
        found = true + factor * (camera.estimate.translation[:2] - true)
        outline = ellipse_points(found, factor**2 * camera.covariance[:2, :2], 1.0)
        marks.append(polygon(plan(outline), class_="ellipse"))
        x, y = plan(found)
        marks.append(circle(x, y, 2.6, class_="found"))
    marks.append(_name(camera, plan))
    return group(*marks, class_=f"k{index % PALETTE}")


def _name(camera: CameraResult, plan: Plan) -> str:
    """The name where the camera looks, in its wedge."""
    eye, forward = camera.truth.translation[:2], camera.truth.rotation[:2, 2]
    place = eye + 0.62 * _VIEW_M * forward / np.linalg.norm(forward)
    x, y = plan(place)
    return text(x, y + 5, camera.name, class_="name")


def _way(track: Track, plan: Plan, kind: str) -> str:
    step = max(1, len(track.places) // _MOST_POINTS)
    points = np.concatenate([track.places[::step], track.places[-1:]])
    return polyline(plan(points), class_=kind) if len(track.places) else ""


def _ends(track: Track, plan: Plan) -> str:
    """The robot's start as a ring and its end as an arrow."""
    x, y = plan(track.places[0])
    start = circle(x, y, 4.5, class_="start")
    heading = track.headings[-1]
    ahead, aside = _unit(heading), _unit(heading + np.pi / 2)
    tip = track.places[-1] + np.array([0.16 * ahead, -0.08 * ahead + 0.1 * aside, [0.0, 0.0]])
    tip = np.vstack([tip, track.places[-1] - 0.08 * ahead - 0.1 * aside])
    tip[2] = track.places[-1] - 0.03 * ahead
    return start + polygon(plan(tip), class_="end")


def _unit(angle: float) -> Array:
    return np.array([np.cos(angle), np.sin(angle)])


def _scale_bar(plan: Plan) -> str:
    """One metre, and the map's axes where its origin is."""
    y = plan.height + 6
    bar = line(MARGIN, y, MARGIN + plan.scale, y) + line(MARGIN, y - 4, MARGIN, y + 4)
    bar += line(MARGIN + plan.scale, y - 4, MARGIN + plan.scale, y + 4)
    words = text(MARGIN + plan.scale + 8, y + 4.5, "1 m")
    return group(bar, words, class_="scale")


def legend(factor: int, *, suggests: bool) -> str:
    """What the marks on the map mean, as a list; `suggests`: whether there is a next pose."""
    larger = f" (errors and ellipses are drawn {factor} times larger)" if factor > 1 else ""
    ring = circle(17, 7, 5, class_="true-place")
    found = element("ellipse", cx=17, cy=7, rx=14, ry=6, class_="ellipse")
    found += circle(17, 7, 2.6, class_="found")
    return element(
        "ul",
        _entry(_sample("way true"), "the robot's true way, from the ring to the arrow"),
        _entry(_sample("way corrected"), "its way as Trigpoint said it live"),
        _entry(_sample("way reckoned"), "its way by odometry alone"),
        _entry(ring, "where a camera truly is; the wedge shows where it looks"),
        _entry(found, f"where it was found, with its standard deviation{larger}"),
        _entry(circle(17, 7, 6, class_="next"), _NEXT) if suggests else "",
        class_="legend",
    )


def _sample(kind: str) -> str:
    return polyline(np.array([[2.0, 7.0], [32.0, 7.0]]), class_=kind)


def _entry(mark: str, words: str) -> str:
    sample = element("svg", mark, viewBox="0 0 34 14", aria_hidden="true", class_="k0")
    return element("li", sample, element("span", words))
