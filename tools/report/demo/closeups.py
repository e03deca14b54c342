"""Each camera up close: where it was found around where it truly is."""

from html import escape

import numpy as np

from trigpoint.base.words import two_decimals
from trigpoint.tools.pages.plan import Plan
from trigpoint.tools.pages.svg import (
    camera_colour,
    circle,
    drawing,
    element,
    ellipse_points,
    group,
    line,
    polygon,
    text,
)

from .results import CameraResult, DemoResults

SIZE = 176.0
_HALF = SIZE / 2
_ROOM = 0.84
_NICE_CM = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500)
SIGMAS_95 = 2.4477
"""Of a normal place on the floor, 95 of 100 lie within this many sigmas: √(-2 ln 0.05)."""


def closeups(results: DemoResults, plan: Plan) -> str:
    """One small drawing a camera, in a grid, turned as the map is."""
    return element(
        "div",
        *(_figure(camera, index, plan) for index, camera in enumerate(results.cameras)),
        class_="closeups",
    )


def _figure(camera: CameraResult, index: int, plan: Plan) -> str:
    if camera.error is None:
        why = "; ".join(camera.record.undetermined) or "the robot never showed it its target"
        body = element("p", f"{camera.record.status}: {why}", class_="quiet")
        caption = element("figcaption", element("b", camera.name))
        return element("figure", body, caption, class_=f"{camera_colour(index)} absent")
    caption = element(
        "figcaption",
        element("b", camera.name),
        escape(f" {two_decimals(100 * camera.error.position)} cm off"),
        element("span", f"{camera.error.sigmas:.1f} sigmas"),
    )
    return element("figure", _target(camera, plan), caption, class_=camera_colour(index))


def _target(camera: CameraResult, plan: Plan) -> str:
    """From above, the truth in the middle."""
    assert camera.record.map_from_camera is not None
    error = (camera.record.map_from_camera.translation - camera.truth.translation)[:2]
    spread = camera.record.covariance_matrix[:2, :2]
    inner, outer = (ellipse_points(error, spread, sigmas) for sigmas in (1.0, SIGMAS_95))
    reach = max(float(np.linalg.norm(outer, axis=1).max()), float(np.linalg.norm(error)))
    scale = _ROOM * _HALF / reach
    x, y = _HALF + scale * plan.turned(error)
    return drawing(
        SIZE,
        SIZE,
        _rings(reach, scale),
        polygon(_HALF + scale * plan.turned(outer), class_="outline"),
        polygon(_HALF + scale * plan.turned(inner), class_="ellipse"),
        line(_HALF, _HALF, x, y, class_="error"),
        circle(_HALF, _HALF, 4, class_="true-place"),
        circle(x, y, 3, class_="found"),
        label=f"Camera {camera.name} from above: its error and its uncertainty",
    )


def _rings(reach: float, scale: float) -> str:
    """Circles around the truth at a round distance, and its half."""
    distance_cm = max((cm for cm in _NICE_CM if cm <= 100 * reach), default=_NICE_CM[0])
    radius = distance_cm / 100 * scale
    cross = line(_HALF, 6, _HALF, SIZE - 6) + line(6, _HALF, SIZE - 6, _HALF)
    rings = circle(_HALF, _HALF, radius) + circle(_HALF, _HALF, radius / 2)
    size = f"{distance_cm:g} cm" if distance_cm >= 0.1 else f"{10 * distance_cm:g} mm"
    words = text(_HALF + 4, _HALF - radius - 4, size, class_="ring-text")
    return group(cross, rings, words, class_="rings")
