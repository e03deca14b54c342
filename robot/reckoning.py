"""Dead reckoning from one known pose: where odometry puts the robot since, and how surely.

The noise is the contract's (section 2, «Odometry noise»). The scale errors ride along as two more
unknowns, so that they add up over the whole way as they do in the robot.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np

from trigpoint.config import OdometryNoise
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array, exp, hat, log
from trigpoint.geometry.uncertainty import carried_covariance

from .odometry import OdometryHistory, Stamped


@dataclass(frozen=True, slots=True)
class Belief:
    """`map_from_base` at a moment; `covariance`: (8, 8), the pose's (6, 6) by the contract, then
    the scale errors of distance and heading."""

    at: Stamped
    map_from_base: Pose
    covariance: Array

    @property
    def pose_covariance(self) -> Array:
        """(6, 6)."""
        return self.covariance[:6, :6]


def anchored(at: Stamped, map_from_base: Pose, covariance: Array, noise: OdometryNoise) -> Belief:
    """The belief right after a correction with `covariance` (6, 6)."""
    extended = np.zeros((8, 8))
    extended[:6, :6] = covariance
    extended[6, 6], extended[7, 7] = noise.distance_scale**2, noise.heading_scale**2
    return Belief(at, map_from_base, extended)


def advanced(belief: Belief, to: Stamped, noise: OdometryNoise) -> Belief:
    """The belief after the motion that odometry reports from `belief.at` to `to`."""
    step = belief.at.odom_from_base.inverse() @ to.odom_from_base
    turn = log(step.rotation)
    rotation = belief.map_from_base.rotation
    way = rotation @ step.translation
    carry = np.eye(8)
    carry[:3, 3:6] = -hat(way)
    carry[:3, 6] = way
    carry[3:6, 7] = rotation @ turn
    covariance = carry @ belief.covariance @ carry.T
    added = _step_covariance(step.translation, turn, noise)
    covariance[:6, :6] += carried_covariance(belief.map_from_base, added)
    return Belief(to, belief.map_from_base @ step, covariance)


def _step_covariance(way: Array, turn: Array, noise: OdometryNoise) -> Array:
    """(6, 6) of one increment in the frame of its start; the direction is the mid-heading's."""
    length, turned = float(np.linalg.norm(way)), float(np.linalg.norm(turn))
    middle = exp(0.5 * turn)
    spread = np.array([noise.distance**2, noise.lateral**2, noise.vertical**2]) * length
    tilt = noise.tilt**2 * length + noise.tilt_turn**2 * turned
    heading = noise.heading_drive**2 * length + noise.heading_turn**2 * turned
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = (middle * spread) @ middle.T
    covariance[[3, 4, 5], [3, 4, 5]] = tilt, tilt, heading
    return covariance


class Reckoning:
    """Beliefs of the last few seconds since an anchor, one per odometry message."""

    def __init__(self, anchor: Belief, history: OdometryHistory, noise: OdometryNoise) -> None:
        self._noise = noise
        self._beliefs: deque[Belief] = deque([anchor])
        for entry in history.after(anchor.at.stamp_ns):
            self.add(entry)

    def add(self, entry: Stamped) -> None:
        """Go on to the newest odometry message."""
        self._beliefs.append(advanced(self._beliefs[-1], entry, self._noise))

    def forget(self, before_ns: int) -> None:
        """Drop what is older; the last belief before that moment stays as the start."""
        while len(self._beliefs) > 1 and self._beliefs[1].at.stamp_ns <= before_ns:
            self._beliefs.popleft()

    def at(self, moment: Stamped) -> Belief:
        """The belief at a moment; also shortly before the anchor, by the motion back to it."""
        for belief in reversed(self._beliefs):
            if belief.at.stamp_ns <= moment.stamp_ns:
                return advanced(belief, moment, self._noise)
        return advanced(self._beliefs[0], moment, self._noise)
