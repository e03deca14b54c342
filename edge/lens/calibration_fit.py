"""One lens model fitted to views by OpenCV, and how well it fits other views.

The minimum is OpenCV's (`calibrateCamera`, `fisheye.calibrate`); here are only its inputs and what
comes out, by the contract's names.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import cv2
import numpy as np

from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.camera import LensModel
from trigpoint.geometry.rotation import Array, hat

from .calibration_views import FEWEST_CORNERS, View

_SEEN = 0.99
_STEPS = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-10)


_Solution = tuple[np.ndarray, np.ndarray, Sequence[np.ndarray], Sequence[np.ndarray]]
"""K, distortion, and a rotation vector and a translation for each view."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A camera and where each view's face was; `errors`: measured minus predicted, (n, 2) each."""

    camera: CameraModel
    camera_from_face: tuple[Pose, ...]
    errors: tuple[Array, ...]

    @property
    def rms_px(self) -> float:
        """Root mean square of a corner's distance from its prediction, as OpenCV and ROS say it."""
        squares = np.concatenate([np.sum(error**2, axis=1) for error in self.errors])
        return float(np.sqrt(squares.mean()))

    @property
    def view_rms_px(self) -> Array:
        """The same of every view, (views,)."""
        return np.array([np.sqrt(np.mean(np.sum(error**2, axis=1))) for error in self.errors])


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """Where a view's face was; `error`: measured minus predicted, (n, 2)."""

    camera_from_face: Pose
    error: Array

    @property
    def rms_px(self) -> float:
        """Root mean square of a corner's distance from its prediction."""
        return float(np.sqrt(np.mean(np.sum(self.error**2, axis=1))))


def fit(model: LensModel, views: Sequence[View], size: tuple[int, int]) -> Fit | None:
    """The least-squares fit of a model; `size`: width, height. None where OpenCV finds none, or the
    lens that it finds folds back within the picture."""
    try:
        camera, poses = _solve(model, views, size)
    except (cv2.error, ValueError):  # a matrix that is singular, or a lens of no focal length
        return None
    if not _is_unfolded(camera, poses, views):
        return None
    return Fit(camera, poses, _errors(camera, poses, views))


def place(camera: CameraModel, view: View) -> Placed | None:
    """Another view under a lens that is given: only its pose is fitted. None where the lens leads
    to no such pixels.

    The pose comes from the pixels freed from distortion; what is left of its error in pixels is
    taken off to first order, so that `error` is that of the best pose.
    """
    directions = camera.directions(view.pixels)
    known = np.isfinite(directions).all(axis=1)
    if known.sum() < FEWEST_CORNERS:
        return None
    _, turn, where = cv2.solvePnP(
        view.points[known], directions[known], np.eye(3), None, flags=cv2.SOLVEPNP_ITERATIVE
    )
    pose = _pose_of(turn, where)
    error = view.pixels - camera.project(pose @ view.points)
    return Placed(pose, _without_pose(error, pose_jacobian(camera, pose, view)[0]))


def pose_jacobian(camera: CameraModel, pose: Pose, view: View) -> tuple[Array, Array]:
    """Derivatives of the view's pixels, row by row, by the pose, (2n, 6), and by the camera's
    `parameters`, (2n, p); the pose's disturbance is the contract's."""
    turned = view.points @ pose.rotation.T
    _, by_point, by_parameters = camera.project_jacobians(turned + pose.translation)
    by_turn = -by_point @ hat(turned)
    by_pose = np.concatenate([by_point, by_turn], axis=-1).reshape(-1, 6)
    return by_pose, by_parameters.reshape(len(by_pose), -1)


def _solve(
    model: LensModel, views: Sequence[View], size: tuple[int, int]
) -> tuple[CameraModel, tuple[Pose, ...]]:
    if model is LensModel.EQUIDISTANT:
        matrix, distortion, turns, places = _solve_fisheye(views, size)
    else:
        flags = cv2.CALIB_RATIONAL_MODEL if model is LensModel.RATIONAL_POLYNOMIAL else 0
        points = [view.points.astype(np.float32) for view in views]
        pixels = [view.pixels.astype(np.float32) for view in views]
        start = np.eye(3), np.zeros(model.coefficients)
        _, matrix, distortion, turns, places = cv2.calibrateCamera(
            points, pixels, size, *start, flags=flags, criteria=_STEPS
        )
    coefficients = distortion.reshape(-1)[: model.coefficients].tolist()
    (fx, _, cx), (_, fy, cy), _ = matrix.tolist()
    camera = CameraModel(*size, fx, fy, cx, cy, tuple(coefficients), model)
    return camera, tuple(_pose_of(*pair) for pair in zip(turns, places, strict=True))


def _solve_fisheye(views: Sequence[View], size: tuple[int, int]) -> _Solution:
    flags = cv2.CALIB_RECOMPUTE_EXTRINSIC | cv2.CALIB_FIX_SKEW
    points = [view.points.reshape(1, -1, 3) for view in views]
    pixels = [view.pixels.reshape(1, -1, 2) for view in views]  # OpenCV 5 takes no (n, 1, 2)
    _, *solution = cv2.fisheye.calibrate(
        points, pixels, size, np.eye(3), np.zeros(4), flags=flags, criteria=_STEPS
    )
    return cast(_Solution, solution)


def _is_unfolded(camera: CameraModel, poses: Sequence[Pose], views: Sequence[View]) -> bool:
    """Whether the lens puts what was seen into the picture, short of where it folds back."""
    seen = [camera.sees(pose @ view.points) for pose, view in zip(poses, views, strict=True)]
    return bool(np.mean(np.concatenate(seen)) > _SEEN)


def _pose_of(turn: np.ndarray, where: np.ndarray) -> Pose:
    """OpenCV's rvec and tvec."""
    return Pose.from_vector(np.concatenate([where.reshape(3), turn.reshape(3)]))


def _errors(camera: CameraModel, poses: Sequence[Pose], views: Sequence[View]) -> tuple[Array, ...]:
    return tuple(
        view.pixels - camera.project(pose @ view.points)
        for pose, view in zip(poses, views, strict=True)
    )


def _without_pose(error: Array, by_pose: Array) -> Array:
    """What no change of the pose explains of an error, (n, 2)."""
    flat = error.reshape(-1)
    change, *_ = np.linalg.lstsq(by_pose, flat)
    return (flat - by_pose @ change).reshape(error.shape)
