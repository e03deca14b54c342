"""Covariances of poses by the contract: x, y, z, rotation about x, y, z, in the parent's axes."""

import numpy as np

from .pose import Pose
from .rotation import Array, hat


def carried_covariance(parent_from_old: Pose, covariance: Array) -> Array:
    """Covariance (6, 6) of `parent_from_old @ pose` where `pose` in `old` has `covariance`.

    The parent's own transform is taken as certain: both halves of the disturbance turn with it.
    """
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = parent_from_old.rotation
    return turn @ covariance @ turn.T


def inverse_jacobian(a_from_b: Pose) -> Array:
    """(6, 6): disturbance of `a_from_b.inverse()` by a disturbance of `a_from_b`.

    From R'ᵀ = Rᵀ Exp(-δθ): the inverse turns by -Rᵀδθ, and its translation -R'ᵀt' moves by
    -Rᵀ(δt + t × δθ) to first order.
    """
    transposed = a_from_b.rotation.T
    jacobian = np.zeros((6, 6))
    jacobian[:3, :3] = -transposed
    jacobian[:3, 3:] = -transposed @ hat(a_from_b.translation)
    jacobian[3:, 3:] = -transposed
    return jacobian


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
