"""Views of a board for tests of calibration: projected by a known lens, with known noise."""

import numpy as np

from trigpoint.edge.lens.calibration_views import View
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.camera import LensModel
from trigpoint.geometry.rotation import exp

SIZE = (640, 480)
PINHOLE = CameraModel(*SIZE, 540.0, 542.0, 322.0, 237.0, (-0.25, 0.06, 5e-4, -3e-4, 0.0))
FISHEYE = CameraModel(
    *SIZE, 260.0, 261.0, 322.0, 237.0, (-0.02, 0.004, 0.001, -5e-4), LensModel.EQUIDISTANT
)
_x, _y = np.meshgrid(np.arange(8), np.arange(6))
BOARD = np.stack([_x, _y, 0 * _x], axis=-1).reshape(-1, 3) * 0.03


def board_views(
    count: int,
    seed: int,
    *,
    camera: CameraModel = PINHOLE,
    noise: float = 0.1,
    tilt_deg: float = 50.0,
    near: float = 0.3,
) -> list[View]:
    """Views anywhere in the picture, from `near` to 0.8 m away, slanted by up to `tilt_deg`."""
    random = np.random.default_rng(seed)
    views: list[View] = []
    while len(views) < count:
        pose = _pose(random, camera, tilt_deg, near)
        points = pose @ BOARD
        if camera.sees(points).all():
            pixels = camera.project(points) + random.normal(0, noise, (len(BOARD), 2))
            views.append(View(f"v{len(views)}", BOARD, pixels, noise))
    return views


def _pose(random: np.random.Generator, camera: CameraModel, tilt_deg: float, near: float) -> Pose:
    tilt, way = np.radians(random.uniform(0, tilt_deg)), random.uniform(0, 2 * np.pi)
    rotation = exp([tilt * np.cos(way), tilt * np.sin(way), 0.0])
    rotation = rotation @ exp([0.0, 0.0, random.uniform(-0.5, 0.5)])
    direction = camera.directions(random.uniform([40.0, 40.0], [600.0, 440.0]))
    middle = np.array([*direction, 1.0]) * random.uniform(near, 0.8)
    return Pose(rotation, middle - rotation @ BOARD.mean(axis=0))
