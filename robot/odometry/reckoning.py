"""Dead reckoning: how odometry errors grow with motion, in the frame of the moving base.

The noise is the contract's (`odometry_noise`). The scale errors are two more unknowns, so that they
add up over the whole path as they do in the robot. A covariance here is (8, 8): a disturbance of
map_from_base in the base's own axes (map_from_base @ disturbance: shift, then rotation vector),
then the scale errors of distance and heading. In those axes a step is the same wherever the robot
is, so many covariances are carried forward together.
"""

from collections.abc import Iterable

import numpy as np
from msgspec import Struct

from trigpoint.contract.odometry_noise import step_variances
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array, exp, hat, log
from trigpoint.geometry.uncertainty import turned_axes
from trigpoint.site.config import OdometryNoise

POSE = slice(0, 6)


class Step(Struct, frozen=True):
    """The effect of one step on covariances: `carry` @ c @ `carry`ᵀ + `added`, (8, 8)."""

    carry: Array
    added: Array


def steps_along(poses: Pose, noise: OdometryNoise) -> list[Step]:
    """The steps from each reported pose (n) to the next. Vectorised: the five between two
    corrections take no longer than a single one."""
    back = np.swapaxes(poses.rotation[:-1], -1, -2)
    way = (back @ np.diff(poses.translation, axis=0)[..., None])[..., 0]
    rotation = back @ poses.rotation[1:]
    turn = log(rotation)
    carry, added = _carry(way, rotation, turn), _added(way, rotation, turn, noise)
    return [Step(*step) for step in zip(carry, added, strict=True)]


def _carry(way: Array, rotation: Array, turn: Array) -> Array:
    end_from_begin = np.swapaxes(rotation, -1, -2)
    carry = np.zeros((len(way), 8, 8))
    carry[:, [6, 7], [6, 7]] = 1.0
    carry[:, :3, :3] = carry[:, 3:6, 3:6] = end_from_begin
    carry[:, :3, 3:6] = -end_from_begin @ hat(way)
    carry[:, :3, 6] = (end_from_begin @ way[..., None])[..., 0]
    carry[:, 3:6, 7] = turn  # about its own axis, which the turn leaves unchanged
    return carry


def _added(way: Array, rotation: Array, turn: Array, noise: OdometryNoise) -> Array:
    """The noise (n, 8, 8) added by steps, in the axes at their ends; that of the shift is along and
    across the direction at mid-heading."""
    length, turned = np.sqrt(np.sum(way * way, axis=-1)), np.sqrt(np.sum(turn * turn, axis=-1))
    end_from_begin = np.swapaxes(rotation, -1, -2)
    end_from_middle = end_from_begin @ exp(0.5 * turn)
    variances = step_variances(noise, length, turned)
    added = np.zeros((len(way), 8, 8))
    added[:, :3, :3] = _spread(end_from_middle, variances.translation)
    added[:, 3:6, 3:6] = _spread(end_from_begin, variances.rotation)
    return added


def _spread(rotation: Array, variances: Array) -> Array:
    """(n, 3, 3) of independent variances (n, 3) along the axes of rotations (n, 3, 3)."""
    return (rotation * variances[:, None, :]) @ np.swapaxes(rotation, -1, -2)


def started(map_from_base: Pose, covariance: Array, noise: OdometryNoise) -> Array:
    """(8, 8) at a moment when the pose is known with the contract's `covariance` (6, 6)."""
    base_from_map = turned_axes(map_from_base.rotation.T)
    found = np.zeros((8, 8))
    found[POSE, POSE] = base_from_map @ covariance @ base_from_map.T
    found[6, 6], found[7, 7] = noise.distance_scale**2, noise.heading_scale**2
    return found


def carried(covariances: Array, steps: Iterable[Step]) -> Array:
    """Covariances (…, 8, 8) after these steps."""
    for step in steps:
        covariances = step.carry @ covariances @ step.carry.T + step.added
    return covariances


def pose_covariances(map_from_base: Pose, covariances: Array) -> Array:
    """The contract's (…, 6, 6) covariances of poses (…), from the (…, 8, 8) used here."""
    map_from_base_axes = turned_axes(map_from_base.rotation)
    return (
        map_from_base_axes @ covariances[..., POSE, POSE] @ np.swapaxes(map_from_base_axes, -1, -2)
    )
