"""Errors of poses in the contract's convention, and their covariances.

An error is a disturbance (δt, δθ), t' = t + δt, R' = Exp(δθ) R: metres and radians in the parent's
axes (`Pose.disturbed`, `Pose.difference`). The covariance (6, 6) of a pose is that of its
disturbance. Two places use other errors inside and convert what they hand out: the extended Kalman
filter's are left twists (`fusion.estimators.filters.pose_errors`, `kalman_state`), those of a
robot's dead reckoning are in the moving base's axes (`robot.reckoning`).
"""

import numpy as np

from .pose import Pose
from .rotation import Array, hat


def position_sigma(covariance: Array) -> float:
    """Root of the trace of the position's part of a (6, 6), metres: how well a place is known."""
    return float(np.sqrt(max(0.0, np.trace(covariance[:3, :3]))))


def carried_covariance(parent_from_old: Pose, covariance: Array) -> Array:
    """Covariance (6, 6) of `parent_from_old @ pose` where `pose` in `old` has `covariance`.

    The parent's own transform is taken as certain: both halves of the disturbance turn with it.
    """
    turn = turned_axes(parent_from_old.rotation)
    return turn @ covariance @ turn.T


def turned_axes(rotation: Array) -> Array:
    """(…, 6, 6) that takes a disturbance from an old parent's axes into a new one's, by
    new_from_old (…, 3, 3)."""
    turn = np.zeros((*rotation.shape[:-2], 6, 6))
    turn[..., :3, :3] = turn[..., 3:, 3:] = rotation
    return turn


def lever(arm: Array) -> Array:
    """(…, 6, 6) that takes the disturbance of a pose to that of something fixed to it, `arm` (…, 3)
    away in the same axes: δt + δθ × arm and δθ."""
    jacobian = np.zeros((*arm.shape[:-1], 6, 6))
    jacobian[...] = np.eye(6)
    jacobian[..., :3, 3:] = -hat(arm)
    return jacobian


def relative_jacobians(parent_from_a: Pose, parent_from_b: Pose) -> tuple[Array, Array]:
    """Derivatives of the disturbance of a_from_b by those of a and of b in their parent, (…, 6, 6)
    each.

    With C = R_aᵀ: t = C (t_b - t_a), so ∂t/∂δt_b = C, ∂t/∂δt_a = -C, ∂t/∂δθ_a = C [t_b - t_a]×, and
    both rotations turn with C.
    """
    to_a = np.swapaxes(parent_from_a.rotation, -1, -2)
    between = parent_from_b.translation - parent_from_a.translation
    shape = np.broadcast_shapes(parent_from_a.rotation.shape, parent_from_b.rotation.shape)
    by_b = turned_axes(np.broadcast_to(to_a, shape))
    by_a = -by_b
    by_a[..., :3, 3:] = to_a @ hat(between)
    return by_a, by_b


def planar_covariance(covariance: Array) -> Array:
    """The contract's (6, 6) of a planar pose from its (3, 3) over x, y, heading."""
    full = np.zeros((6, 6))
    full[np.ix_([0, 1, 5], [0, 1, 5])] = covariance
    return full


def symmetric(matrix: Array) -> Array:
    """The mean of a matrix and its transpose, against rounding; (…, n, n)."""
    return 0.5 * (matrix + np.swapaxes(matrix, -1, -2))


def is_positive_semidefinite(matrix: Array, tolerance: float = 1e-9) -> bool:
    """Whether a covariance is one, up to `tolerance` of its largest eigenvalue."""
    if not np.all(np.isfinite(matrix)):
        return False
    values = np.linalg.eigvalsh(symmetric(matrix))
    return bool(values[0] >= -tolerance * max(values[-1], 1e-300))
