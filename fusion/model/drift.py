"""The drift of odometry between any two of a robot's moments: its covariance and scale errors."""

from typing import Self

import numpy as np
from msgspec import Struct

from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import lever, turned_axes

from .odometry import OdometryTrack


class Drift(Struct, frozen=True):
    """The drift accumulated up to each of m moments, referred to the mean of the robot's positions:
    `noise` (m, 6, 6), its covariance, and `by_scale` (m, 6, 2), its derivative by the two scale
    errors; `arms` (m, 3) from that point to the robot; in the axes of its poses' parent."""

    noise: Array
    by_scale: Array
    arms: Array

    @classmethod
    def of(
        cls, track: OdometryTrack, stamps_ns: np.ndarray, scales: Array, parent_from_base: Pose
    ) -> Self:
        """Accumulate over ascending moments (m,), with the robot at `parent_from_base` (m)."""
        arms = parent_from_base.translation - parent_from_base.translation.mean(axis=0)
        noise, by_scale = np.zeros((len(arms), 6, 6)), np.zeros((len(arms), 6, 2))
        if len(arms) > 1:
            motion = track.motion(stamps_ns, scales)
            # A step's error acts about the step's end; it is referred to the common point.
            turn = lever(-arms[1:]) @ turned_axes(parent_from_base.rotation[:-1])
            noise[1:] = np.cumsum(turn @ motion.covariance @ np.swapaxes(turn, 1, 2), axis=0)
            by_scale[1:] = np.cumsum(turn @ motion.by_scale, axis=0)
        return cls(noise, by_scale, arms)

    def between(self, first: np.ndarray, second: np.ndarray) -> tuple[Array, Array]:
        """The drift of the robot at moments `second` (…) since `first`: its covariance (…, 6, 6) by
        noise, and its derivative (…, 6, 2) by the scale errors."""
        swing = lever(self.arms[second])
        sign = np.where(second >= first, 1.0, -1.0)[..., None, None]
        noise = sign * (self.noise[second] - self.noise[first])
        by_scale = self.by_scale[second] - self.by_scale[first]
        return swing @ noise @ np.swapaxes(swing, -1, -2), swing @ by_scale
