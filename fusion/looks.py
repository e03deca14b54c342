"""How well many camera poses fit many observations, roughly and fast."""

from dataclasses import dataclass

import numpy as np

from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.rotation import Array
from trigpoint.target import Target

from .body import Body, body_of, by_reading, can_be_seen, faces_of, outermost
from .observations import Observation

# What a corner costs at most, pixels: beyond it a view fits not at all.
WORST_PX = 20.0
_NEAREST_M = 1e-2
# How far off a view may be to draw at full strength, step by step.
_REACHES_PX = (60.0, 30.0, 15.0, 8.0)
_LONGEST_STEP = 0.3  # m and rad
_LEAST_INFORMATION = 1.0  # pixels² per m² and rad²: keeps what nothing draws where it is


@dataclass(frozen=True, slots=True)
class _FewCorners:
    """A view at its outermost corners: `points` (r, k, 3) by reading in the base frame, `faces`
    (r,), `pixels` (k, 2)."""

    points: Array
    faces: np.ndarray
    pixels: Array


@dataclass(frozen=True, slots=True)
class Look:
    """An observation made ready for `mean_cost`."""

    map_from_base: Pose
    body: Body
    views: tuple[_FewCorners, ...]


def look_of(observation: Observation, target: Target, map_from_base: Pose) -> Look:
    """A look at an observation, at its outermost corners alone."""
    body, views = body_of(target), []
    for view in observation.views:
        few = outermost(view.pixels)
        views.append(_FewCorners(by_reading(view, body)[:, few], faces_of(view), view.pixels[few]))
    return Look(map_from_base, body, tuple(views))


def mean_cost(map_from_camera: Pose, looks: list[Look], lens: CameraModel) -> Array:
    """How badly camera poses (n) fit many observations: the mean over their views of the least
    mean-square reprojection error, pixels², each capped, (n,)."""
    total, views = np.zeros(len(map_from_camera)), 0
    for look in looks:
        camera_from_base = map_from_camera.inverse() @ look.map_from_base
        for view in look.views:
            views += 1
            total += _least_cost(lens, camera_from_base, look.body, view)
    return total / max(views, 1)


def drawn(map_from_camera: Pose, looks: list[Look], lens: CameraModel) -> Pose:
    """Camera poses (n) drawn to where they fit the observations better, with the robot held where
    it is believed to stand; a view that is far off draws less (Geman and McClure's weights)."""
    poses = map_from_camera
    for reach_px in _REACHES_PX:
        hessian, gradient = np.zeros((len(poses), 6, 6)), np.zeros((len(poses), 6, 1))
        for look in looks:
            camera_from_base = poses.inverse() @ look.map_from_base
            for view in look.views:
                jacobian, residual = _pull(lens, poses, camera_from_base, look, view, reach_px)
                transposed = np.swapaxes(jacobian, 1, 2)
                hessian += transposed @ jacobian
                gradient += transposed @ residual[..., None]
        hessian += _LEAST_INFORMATION * np.eye(6)
        step = -np.linalg.solve(hessian, gradient)[..., 0]
        poses = poses.disturbed(np.clip(step, -_LONGEST_STEP, _LONGEST_STEP))
    return poses


def _pull(
    lens: CameraModel,
    map_from_camera: Pose,
    camera_from_base: Pose,
    look: Look,
    view: _FewCorners,
    reach_px: float,
) -> tuple[Array, Array]:
    """Jacobian (n, 2k, 6) and residual (n, 2k) of a view by camera poses (n), as it is read best,
    weighted; pixels."""
    square, optical = _squares(lens, camera_from_base, look.body, view)
    best = np.argmin(square, axis=1)
    rows = np.arange(len(best))
    square, optical = square[rows, best], optical[rows, best]
    weight = np.where(np.isfinite(square), 1 / (1 + square / reach_px**2), 0.0)
    pixels, by_point = lens.project_by_point(optical)
    residual = (pixels - view.pixels) * weight[:, None, None]
    rotation = map_from_camera.rotation
    by_map = (by_point @ np.swapaxes(rotation, 1, 2)[:, None]) * weight[:, None, None, None]
    from_camera = optical @ np.swapaxes(rotation, 1, 2)
    jacobian = np.concatenate([-by_map, by_map @ so3.hat(from_camera)], axis=-1)
    return jacobian.reshape(len(best), -1, 6), residual.reshape(len(best), -1)


def _least_cost(lens: CameraModel, camera_from_base: Pose, body: Body, view: _FewCorners) -> Array:
    square, _ = _squares(lens, camera_from_base, body, view)
    return np.minimum(square, WORST_PX**2).min(axis=1)


def _squares(
    lens: CameraModel, camera_from_base: Pose, body: Body, view: _FewCorners
) -> tuple[Array, Array]:
    """Mean-square error of poses (n) and readings (r), pixels², infinite where the face cannot be
    seen, (n, r); the corners in the optical frame (n, r, k, 3), pushed before the camera."""
    optical = (camera_from_base @ view.points.reshape(-1, 3)).reshape(-1, *view.points.shape)
    ahead = np.all(optical[..., 2] > _NEAREST_M, axis=-1)
    optical = np.where(optical[..., 2:] > _NEAREST_M, optical, [0.0, 0.0, 1.0])
    square = np.mean((lens.project(optical) - view.pixels) ** 2, axis=(-1, -2))
    is_seen = can_be_seen(body, view.faces, view.points, camera_from_base.inverse().translation)
    return np.where(ahead & is_seen, square, np.inf), optical
