"""Dead reckoning: how odometry's errors grow along the way, in the frame of the moving base.

The noise is the contract's (section 2, «Odometry noise»). The scale errors ride along as two more
unknowns, so that they add up over the whole way as they do in the robot. A covariance here is
(8, 8): a disturbance of map_from_base in the base's own axes (map_from_base @ disturbance: shift,
then rotation vector), then the scale errors of distance and heading. In those axes one step is the
same for every place that the robot may be at, so many are carried on together.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from trigpoint.config import OdometryNoise
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array, exp, hat, log

POSE = slice(0, 6)


@dataclass(frozen=True, slots=True)
class Step:
    """What one step of the way does to covariances: `carry` @ c @ `carry`ᵀ + `added`, (8, 8)."""

    carry: Array
    added: Array


def step_between(first: Pose, second: Pose, noise: OdometryNoise) -> Step:
    """The step from one reported pose to the next."""
    back = first.rotation.T  # written out: this runs at every reading
    way = back @ (second.translation - first.translation)
    rotation = back @ second.rotation
    turn = log(rotation)
    return Step(_carry(way, rotation, turn), _added(way, rotation, turn, noise))


def _carry(way: Array, rotation: Array, turn: Array) -> Array:
    carry = np.eye(8)
    carry[:3, :3] = carry[3:6, 3:6] = rotation.T
    carry[:3, 3:6] = -rotation.T @ hat(way)
    carry[:3, 6] = rotation.T @ way
    carry[3:6, 7] = turn  # about its own axis, which the turn leaves as it is
    return carry


def _added(way: Array, rotation: Array, turn: Array, noise: OdometryNoise) -> Array:
    """Along and across the direction at mid-heading, given in the axes at the step's end."""
    length, turned = float(np.linalg.norm(way)), float(np.linalg.norm(turn))
    end_from_middle = rotation.T @ exp(0.5 * turn)
    spread = np.array([noise.distance**2, noise.lateral**2, noise.vertical**2]) * length
    tilt = noise.tilt**2 * length + noise.tilt_turn**2 * turned
    heading = noise.heading_drive**2 * length + noise.heading_turn**2 * turned
    added = np.zeros((8, 8))
    added[:3, :3] = (end_from_middle * spread) @ end_from_middle.T
    added[3:6, 3:6] = (rotation.T * [tilt, tilt, heading]) @ rotation
    return added


def started(map_from_base: Pose, covariance: Array, noise: OdometryNoise) -> Array:
    """(8, 8) at a moment where the pose is known with the contract's `covariance` (6, 6)."""
    base_from_map = _both_halves(map_from_base.rotation.T)
    found = np.zeros((8, 8))
    found[POSE, POSE] = base_from_map @ covariance @ base_from_map.T
    found[6, 6], found[7, 7] = noise.distance_scale**2, noise.heading_scale**2
    return found


def carried(covariances: Array, steps: Iterable[Step]) -> Array:
    """Covariances (…, 8, 8) after these steps."""
    for step in steps:
        covariances = step.carry @ covariances @ step.carry.T + step.added
    return covariances


def pose_covariance(map_from_base: Pose, covariance: Array) -> Array:
    """The contract's (6, 6) of a pose whose covariance here is (8, 8)."""
    map_from_base_axes = _both_halves(map_from_base.rotation)
    return map_from_base_axes @ covariance[POSE, POSE] @ map_from_base_axes.T


def _both_halves(rotation: Array) -> Array:
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = rotation
    return turn
