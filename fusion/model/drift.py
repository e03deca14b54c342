"""How far odometry's noise carries a robot off between two of its moments."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import lever, turned_axes

from .odometry import OdometryTrack


@dataclass(frozen=True, slots=True)
class Drift:
    """What the steps up to each of m moments add, as of something rigid at the moments' middle:
    `noise` (m, 6, 6) and, by the two scale errors, `by_scale` (m, 6, 2); `arms` (m, 3) from there
    to where the robot was; in the axes of its poses' parent."""

    noise: Array
    by_scale: Array
    arms: Array

    @classmethod
    def of(
        cls, track: OdometryTrack, stamps_ns: np.ndarray, scales: Array, parent_from_base: Pose
    ) -> Self:
        """Over rising moments (m,), at which the robot was at `parent_from_base` (m)."""
        arms = parent_from_base.translation - parent_from_base.translation.mean(axis=0)
        noise, by_scale = np.zeros((len(arms), 6, 6)), np.zeros((len(arms), 6, 2))
        if len(arms) > 1:
            motion = track.motion(stamps_ns, scales)
            # An error in a step turns about where the step ends.
            turn = lever(-arms[1:]) @ turned_axes(parent_from_base.rotation[:-1])
            noise[1:] = np.cumsum(turn @ motion.covariance @ np.swapaxes(turn, 1, 2), axis=0)
            by_scale[1:] = np.cumsum(turn @ motion.by_scale, axis=0)
        return cls(noise, by_scale, arms)

    def between(self, first: np.ndarray, second: np.ndarray) -> tuple[Array, Array]:
        """Of the robot at moments `second` (…) from where it was at `first`: the covariance
        (…, 6, 6) by noise, and what scale errors do (…, 6, 2)."""
        swing = lever(self.arms[second])
        sign = np.where(second >= first, 1.0, -1.0)[..., None, None]
        noise = sign * (self.noise[second] - self.noise[first])
        by_scale = self.by_scale[second] - self.by_scale[first]
        return swing @ noise @ np.swapaxes(swing, -1, -2), swing @ by_scale
