"""Where a target is before a camera, from one picture: every pose that fits, best first.

One plane has two solutions, which often fit equally well (Collins and Bartoli, «Infinitesimal
plane-based pose estimation», 2014); two faces together are solid and have one.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.rotation import Array

_MINIMUM_CORNERS = 4


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
    fits = []
    for turn, shift in zip(turns, shifts, strict=True):
        rotation = so3.exp(np.asarray(turn).reshape(3))
        pose = Pose(rotation, np.asarray(shift).reshape(3) - rotation @ centre)
        fits.append(refined_pose(lens, pose, points, pixels, sigma))
    shown = [fit for fit in fits if fit is not None and _shows_front(fit.pose, centre)]
    return sorted(shown, key=lambda fit: fit.rms)


def _shows_front(camera_from_plane: Pose, centre: Array) -> bool:
    return bool(camera_from_plane.rotation[:, 2] @ (camera_from_plane @ centre) > 0)


def refined_pose(
    lens: CameraModel, start: Pose, points: Array, pixels: Array, sigma: float | Array
) -> PoseFit | None:
    """The pose of least reprojection error near `start`, by Gauss-Newton; None where it diverges.

    `sigma`: of a coordinate, a number or (n,).
    """
    pose, residual = start, np.zeros(0)
    weights = np.broadcast_to(1 / np.asarray(sigma), (len(points),))[:, None]
    for _ in range(10):
        arm = points @ pose.rotation.T
        optical = arm + pose.translation
        if np.any(optical[:, 2] < 1e-3):
            return None
        projected, by_point, _ = lens.project_jacobians(optical)
        residual = ((projected - pixels) * weights).reshape(-1)
        if not np.all(np.isfinite(residual)):
            return None
        jacobian = np.concatenate([by_point, -by_point @ so3.hat(arm)], axis=-1)
        jacobian = (jacobian * weights[..., None]).reshape(-1, 6)
        hessian = jacobian.T @ jacobian
        step = -np.linalg.lstsq(hessian, jacobian.T @ residual, rcond=1e-12)[0]
        pose = pose.disturbed(step)
        if np.abs(step).max() < 1e-7:
            break
    if not np.all(np.isfinite(pose.translation)) or np.linalg.norm(pose.translation) > 1e3:
        return None
    return PoseFit(pose, float(np.sqrt(np.mean(residual**2))))
