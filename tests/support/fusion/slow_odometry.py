"""The term of odometry in a cost, written out with numpy; the core is held to it."""

import numpy as np
from msgspec import Struct

from trigpoint.fusion.model.motion import Motion
from trigpoint.geometry import Pose
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import relative_jacobians


class OdometryTerms(Struct, frozen=True):
    """Whitened residual (n, d) between consecutive nodes, and its derivatives."""

    residual: Array
    by_earlier: Array
    by_later: Array
    by_scale: Array


def odometry_terms(earlier: Pose, later: Pose, motion: Motion, tangent: list[int]) -> OdometryTerms:
    """Odometry's residual: t = R_iᵀ(t_j - t_i) - Δt, r = Log(R_iᵀ R_j ΔRᵀ), whitened."""
    whole = (earlier.inverse() @ later).difference(motion.earlier_from_later)
    by_earlier, by_later = relative_jacobians(earlier, later)
    inverse = np.linalg.inv(so3.left_jacobian(whole[:, 3:]))
    by_later[:, 3:, 3:] = inverse @ by_later[:, 3:, 3:]
    by_earlier[:, 3:, 3:] = -by_later[:, 3:, 3:]
    by_scale = -motion.by_scale
    by_scale[:, 3:] = np.swapaxes(inverse, 1, 2) @ by_scale[:, 3:]
    free = np.ix_(range(len(whole)), tangent, tangent)
    white = np.linalg.inv(np.linalg.cholesky(motion.covariance[free]))
    return OdometryTerms(
        (white @ whole[:, tangent, None])[..., 0],
        white @ by_earlier[free],
        white @ by_later[free],
        white @ by_scale[:, tangent],
    )
