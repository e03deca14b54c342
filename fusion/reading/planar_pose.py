"""Where a target is before a camera, from one picture: every pose that fits, best first.

One plane has two solutions, which often fit equally well (Collins and Bartoli, «Infinitesimal
plane-based pose estimation», 2014); two faces together are solid and have one.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from trigpoint.fusion.model.projection import projected
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.rotation import Array

_MINIMUM_CORNERS = 4
_MOST_STEPS = 10
_SMALLEST_STEP = 1e-7
_FARTHEST_M = 1e3


@dataclass(frozen=True, slots=True)
class PoseFit:
    """camera_from_object, and the reprojection's RMS of a coordinate in sigmas."""

    pose: Pose
    rms: float


def planar_poses(lens: CameraModel, points: Array, pixels: Array, sigma: float) -> list[PoseFit]:
    """Both poses of one plane; points (n, 3) with z = 0, pixels (n, 2) raw.

    z points away from whoever sees the plane's front: what fits from behind alone, as a mirrored
    order of the corners does, is left out. An empty list where fewer than four corners are seen or
    they lie on a line.
    """
    if len(points) < _MINIMUM_CORNERS or np.linalg.matrix_rank(points - points[0], tol=1e-6) < 2:
        return []
    directions = lens.directions(pixels)
    if not np.all(np.isfinite(directions)):
        return []
    centre = points.mean(axis=0)
    try:
        _, turns, shifts, _ = cv2.solvePnPGeneric(
            np.ascontiguousarray(points - centre),
            np.ascontiguousarray(directions)[:, None],
            np.eye(3),
            np.zeros(5),
            flags=cv2.SOLVEPNP_IPPE,
        )
    except cv2.error:
        return []
    rotations = so3.exp(np.reshape(turns, (-1, 3)))
    starts = Pose(rotations, np.reshape(shifts, (-1, 3)) - rotations @ centre)
    both = np.broadcast_to(points, (len(starts), *points.shape))
    fits = refined_poses(lens, starts, both, pixels, sigma)
    shown = [fit for fit in fits if fit is not None and _shows_front(fit.pose, centre)]
    return sorted(shown, key=lambda fit: fit.rms)


def _shows_front(camera_from_plane: Pose, centre: Array) -> bool:
    return bool(camera_from_plane.rotation[:, 2] @ (camera_from_plane @ centre) > 0)


def refined_poses(
    lens: CameraModel, starts: Pose, points: Array, pixels: Array, sigma: float | Array
) -> list[PoseFit | None]:
    """The poses of least reprojection error near many starts (b), each with its own points
    (b, n, 3), by Gauss-Newton; None where it diverges.

    `pixels`: (n, 2); `sigma`: of a coordinate, a number or (n,).
    """
    if not len(points):
        return []  # OpenCV returns no pose for nearly collinear corners
    weights = np.broadcast_to(1 / np.asarray(sigma), (points.shape[1],))[:, None]
    pose, rms = starts, np.full(len(points), np.nan)
    is_sound = np.ones(len(points), dtype=bool)
    for _ in range(_MOST_STEPS):
        found = projected(lens, pose, points)
        residual = ((found.pixels - pixels) * weights).reshape(len(points), -1)
        is_sound &= np.all(found.is_ahead, axis=1) & np.all(np.isfinite(residual), axis=1)
        jacobian = (found.by_body * weights[..., None]).reshape(*residual.shape, 6)
        step = least_squares_steps(jacobian, residual, is_sound)
        rms = np.sqrt(np.mean(residual**2, axis=1))
        pose = pose.disturbed(step)
        if np.abs(step).max() < _SMALLEST_STEP:
            break
    is_sound &= np.linalg.norm(pose.translation, axis=-1) < _FARTHEST_M
    return [PoseFit(pose[i], float(rms[i])) if is_sound[i] else None for i in range(len(is_sound))]


def least_squares_steps(jacobian: Array, residual: Array, is_wanted: np.ndarray) -> Array:
    """The least-squares steps (b, k) of equations (b, m, k), (b, m); 0 where they are not wanted.

    Directions that nothing determines are not changed.
    """
    steps = np.zeros((len(residual), jacobian.shape[-1]))
    if np.any(is_wanted):
        transposed = np.swapaxes(jacobian[is_wanted], 1, 2)
        inverse = np.linalg.pinv(transposed @ jacobian[is_wanted], rcond=1e-12, hermitian=True)
        gradient = transposed @ residual[is_wanted][..., None]
        steps[is_wanted] = -(inverse @ gradient)[..., 0]
    return steps
