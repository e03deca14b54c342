"""How well many camera poses fit many views, roughly and fast: all of them at once."""

from dataclasses import dataclass

import numpy as np

from trigpoint.fusion.model.observations import Observation
from trigpoint.fusion.model.projection import NEAREST_M, by_disturbance
from trigpoint.fusion.reading.visibility import (
    Body,
    body_of,
    by_reading,
    can_be_seen,
    faces_of,
    outermost,
)
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array
from trigpoint.site.target import Target

# What a corner costs at most, pixels: beyond it a view fits not at all.
WORST_PX = 20.0
# How far off a view may be to draw at full strength, step by step.
_REACHES_PX = (60.0, 30.0, 15.0, 8.0)
_LONGEST_STEP = 0.3  # m and rad
_LEAST_INFORMATION = 1.0  # pixels² per m² and rad²: keeps what nothing draws where it is


@dataclass(frozen=True, slots=True)
class ViewBatch:
    """Views (v) of one body, with as many readings (r) and outermost corners (k) each:
    `map_from_base` (v), `points` (v, r, k, 3) by reading in the base frame, `faces` (v, r),
    `pixels` (v, k, 2)."""

    body: Body
    map_from_base: Pose
    points: Array
    faces: np.ndarray
    pixels: Array


def view_batches(observation: Observation, target: Target, map_from_base: Pose) -> list[ViewBatch]:
    """A batch of one (v = 1) for each view of an observation."""
    body, here, found = body_of(target), Pose.stack([map_from_base]), []
    for view in observation.views:
        few = outermost(view.pixels)
        points = by_reading(view, body)[:, few]
        found.append(
            ViewBatch(body, here, points[None], faces_of(view)[None], view.pixels[None, few])
        )
    return found


def mean_cost(map_from_camera: Pose, batches: list[ViewBatch], lens: CameraModel) -> Array:
    """How badly camera poses (n) fit many views: the mean over them of the least mean-square
    reprojection error, pixels², each capped, (n,)."""
    total = np.zeros(len(map_from_camera))
    for batch in _together(batches):
        square, _ = _squares(lens, _seen_from(map_from_camera, batch), batch)
        total += np.minimum(square, WORST_PX**2).min(axis=2).sum(axis=1)
    return total / max(sum(len(batch.points) for batch in batches), 1)


def coarsely_refined(map_from_camera: Pose, batches: list[ViewBatch], lens: CameraModel) -> Pose:
    """Camera poses (n) drawn to where they fit the views better, with the robot held where it is
    believed to stand; a view that is far off draws less (Geman and McClure's weights)."""
    poses, groups = map_from_camera, _together(batches)
    for reach_px in _REACHES_PX:
        hessian, gradient = np.zeros((len(poses), 6, 6)), np.zeros((len(poses), 6, 1))
        for batch in groups:
            jacobian, residual = _linearised(lens, poses, batch, reach_px)
            transposed = np.swapaxes(jacobian, 1, 2)
            hessian += transposed @ jacobian
            gradient += transposed @ residual[..., None]
        hessian += _LEAST_INFORMATION * np.eye(6)
        step = -np.linalg.solve(hessian, gradient)[..., 0]
        poses = poses.disturbed(np.clip(step, -_LONGEST_STEP, _LONGEST_STEP))
    return poses


def _together(batches: list[ViewBatch]) -> list[ViewBatch]:
    """Batches of the same body and shape, joined."""
    groups: dict[tuple[int, int, int], list[ViewBatch]] = {}
    for batch in batches:
        groups.setdefault((id(batch.body), *batch.points.shape[1:3]), []).append(batch)
    return [
        ViewBatch(
            group[0].body,
            Pose(
                np.concatenate([batch.map_from_base.rotation for batch in group]),
                np.concatenate([batch.map_from_base.translation for batch in group]),
            ),
            np.concatenate([batch.points for batch in group]),
            np.concatenate([batch.faces for batch in group]),
            np.concatenate([batch.pixels for batch in group]),
        )
        for group in groups.values()
    ]


def _seen_from(map_from_camera: Pose, batch: ViewBatch) -> Pose:
    """camera_from_base (n, v) of camera poses (n)."""
    from_map = map_from_camera.inverse()
    return Pose(from_map.rotation[:, None], from_map.translation[:, None]) @ batch.map_from_base


def _linearised(
    lens: CameraModel, map_from_camera: Pose, batch: ViewBatch, reach_px: float
) -> tuple[Array, Array]:
    """Jacobian (n, 2vk, 6) and residual (n, 2vk) of views by camera poses (n), each as it is read
    best, weighted; pixels."""
    square, optical = _squares(lens, _seen_from(map_from_camera, batch), batch)
    best = np.argmin(square, axis=2)[..., None]
    square = np.take_along_axis(square, best, axis=2)
    optical = np.take_along_axis(optical, best[..., None, None], axis=2)[:, :, 0]
    weight = np.where(np.isfinite(square), 1 / (1 + square / reach_px**2), 0.0)[..., None]
    pixels, by_point = lens.project_by_point(optical)
    residual = (pixels - batch.pixels) * weight
    back = np.swapaxes(map_from_camera.rotation, 1, 2)
    by_map = (by_point @ back[:, None, None]) * weight[..., None]
    from_camera = optical @ back[:, None]
    jacobian = by_disturbance(-by_map, from_camera)
    return jacobian.reshape(len(best), -1, 6), residual.reshape(len(best), -1)


def _squares(lens: CameraModel, camera_from_base: Pose, batch: ViewBatch) -> tuple[Array, Array]:
    """Mean-square error of views (v) from poses (n, v) by reading (r), pixels², infinite where the
    face cannot be seen, (n, v, r); the corners in the optical frame (n, v, r, k, 3), pushed before
    the camera."""
    shape = batch.points.shape
    optical = camera_from_base @ batch.points.reshape(shape[0], -1, 3)
    optical = optical.reshape(-1, *shape)
    ahead = np.all(optical[..., 2] > NEAREST_M, axis=-1)
    optical = np.where(optical[..., 2:] > NEAREST_M, optical, [0.0, 0.0, 1.0])
    square = np.mean((lens.project(optical) - batch.pixels[:, None]) ** 2, axis=(-1, -2))
    eyes = camera_from_base.inverse().translation
    is_seen = can_be_seen(batch.body, batch.faces, batch.points, eyes)
    return np.where(ahead & is_seen, square, np.inf), optical
