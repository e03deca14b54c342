"""Colours, sizes and paths of entities: what the scene and the blueprint must agree on."""

from typing import Any

import numpy as np

from trigpoint.geometry.rotation import Array

Colour = tuple[int, int, int]

CAMERA_COLOURS: tuple[Colour, ...] = (
    (102, 194, 255),
    (255, 179, 71),
    (119, 221, 119),
    (240, 128, 240),
    (255, 236, 110),
    (110, 231, 222),
    (255, 130, 120),
    (176, 160, 255),
    (190, 215, 90),
    (255, 170, 200),
)
ROBOT_COLOURS: tuple[Colour, ...] = ((64, 144, 255), (46, 204, 113), (232, 90, 200), (250, 200, 40))
FACE_COLOURS: tuple[Colour, ...] = (
    (255, 80, 80),
    (80, 220, 100),
    (90, 150, 255),
    (255, 210, 60),
    (230, 110, 255),
)
UNKNOWN_FACE: Colour = (230, 230, 230)
DEAD_RECKONING: Colour = (255, 140, 60)
CORRECTION: Colour = (255, 255, 255)
TEXT: Colour = (245, 245, 245)

SIGMAS_DRAWN = 3.0
MAGNIFIED = 5.0
"""A good camera's sigma is a centimetre, a site's size tens of metres: three sigma could not be
seen, so that ellipsoids are drawn larger, which the map's title says."""
_THINNEST_M = 0.01

FLOOR: Colour = (24, 27, 33)
"""The map's background, and the paper of a floor plan in it."""
WALL: Colour = (150, 160, 178)
LEGEND, LOG = "/legend", "/log"
PLAN, CORRECTED = "/map/plan", "/map/corrected"
BEST, WORST, NEVER = (20, 92, 68), (120, 84, 22), (92, 34, 34)
"""Of the floor: where robots are corrected best, to 99 mm or worse, and not at all."""
CAMERA_SIGMAS, ROBOT_SIGMAS, DRIFT = "/sigma/cameras", "/sigma/robots", "/drift"
HEADING_SIGMAS, LATENCY = "/sigma/headings", "/latency"
RESIDUALS, RATES = "/residuals", "/rates"
REJECTED: Colour = (255, 40, 40)
RESIDUAL: Colour = (255, 240, 120)
RESIDUALS_DRAWN = 10.0
"""A good corner is off by a tenth of a pixel, which nobody would see."""
TRUTH: Colour = (120, 255, 150)
OVERLAY: Colour = (255, 255, 255)
_LEAST = 0.1


def ui_points(points: float) -> float:
    """A radius in points of the screen, which rerun takes as a negative one."""
    return -points


def camera_path(camera: str) -> str:
    return f"/map/cameras/{camera}"


def picture_path(camera: str) -> str:
    """The picture, and below it what was seen in it.

    It is apart from the map, where a camera that is not located has no place.
    """
    return f"/pictures/{camera}"


def seen_path(camera: str) -> str:
    """Where in the picture the target has been seen so far."""
    return f"{picture_path(camera)}/seen"


def frustum_path(camera: str) -> str:
    """The pinhole in the map, with its picture."""
    return f"/map/cameras/{camera}/frustum"


def robot_path(robot: str) -> str:
    return f"/map/robots/{robot}"


def text_only(text: str) -> dict[str, list[Any]]:
    """The components of a point that cannot be seen but for its text.

    A text has its point's colour; white is readable on the plates of the light and the dark theme.
    """
    return {"colors": [TEXT], "radii": [ui_points(0.0)], "labels": [text]}


def dot(colour: Colour, radius: float) -> dict[str, list[Any]]:
    """The components of a point without a text; `radius` in points of the screen."""
    return {"colors": [colour], "radii": [ui_points(radius)]}


def camera_colour(index: int) -> Colour:
    return CAMERA_COLOURS[index % len(CAMERA_COLOURS)]


def robot_colour(index: int) -> Colour:
    return ROBOT_COLOURS[index % len(ROBOT_COLOURS)]


def face_colour(face: int) -> Colour:
    return FACE_COLOURS[face % len(FACE_COLOURS)] if face >= 0 else UNKNOWN_FACE


def ellipsoid(covariance: Array) -> tuple[Array, Array]:
    """Half-axes (3,) in metres and axes (3, 3, columns, right-handed) of a position's (3, 3)."""
    values, axes = np.linalg.eigh(covariance)
    if np.linalg.det(axes) < 0:
        axes[:, 0] = -axes[:, 0]
    sigmas = np.sqrt(np.maximum(values, 0.0))
    return np.maximum(SIGMAS_DRAWN * MAGNIFIED * sigmas, _THINNEST_M), axes


def heading_sigma(covariance: Array) -> float:
    """Standard deviation about the vertical axis of a (6, 6), radians."""
    return float(np.sqrt(max(0.0, covariance[5, 5])))


def decades(value: float) -> float:
    """The decimal logarithm of a sigma in cm or mrad, -1 for all that is below 0.1: rerun's plots
    have no logarithmic axis, and a camera's sigma goes from a metre to a millimetre."""
    return float(np.log10(max(value, _LEAST)))
