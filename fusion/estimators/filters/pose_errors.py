"""Errors of poses as left twists of SE(3): exp(ξ) · map_from_base, ξ = (v, ω), metres and radians.

A rigid motion of the whole map is the same twist for every pose in it, wherever that stands and
however it is estimated; a filter whose errors are twists therefore gains no spurious information
on where the map is from cameras and robots that only see each other, and the effect of a heading
error on a robot's later way is exact (Barrau and Bonnabel, «An EKF-SLAM algorithm with consistency
properties», 2015; Long et al., «The banana distribution is Gaussian», 2012). In the contract's
disturbances, δt = v + ω × t, that holds only to first order about one estimate.
"""

import numpy as np

from trigpoint.geometry import Pose
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import lever


def disturbance_by_twist(pose: Pose) -> Array:
    """The contract's disturbance of a pose by a small twist of it, (…, 6, 6)."""
    return lever(pose.translation)


def twist_by_disturbance(pose: Pose) -> Array:
    """The inverse of `disturbance_by_twist`, (…, 6, 6)."""
    return lever(-pose.translation)


def twisted(pose: Pose, twist: Array) -> Pose:
    """exp(ξ) · pose for twists ξ (…, 6)."""
    return pose.moved((disturbance_by_twist(pose) @ twist[..., None])[..., 0])


def twist_between(start: Pose, end: Pose) -> Array:
    """The twist (…, 6) with `twisted(start, twist)` equal to `end`."""
    turn = so3.log(end.rotation @ np.swapaxes(start.rotation, -1, -2))
    swung = (so3.exp(turn) @ start.translation[..., None])[..., 0]
    apart = (end.translation - swung)[..., None]
    linear = np.linalg.solve(so3.left_jacobian(turn), apart)[..., 0]
    return np.concatenate([linear, turn], axis=-1)
