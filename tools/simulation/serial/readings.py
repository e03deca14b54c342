"""What a simulated robot's encoders say at any moment, as a function of its odometry alone."""

from functools import cached_property

import numpy as np
from msgspec import Struct, field

from trigpoint.base.clock import NANOSECONDS, to_ns
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array, log
from trigpoint.tools.simulation.motion.odometry import OdometryLog, increments


class Readings(Struct, frozen=True, dict=True):
    """A robot's odometry; after the world's end it stands still and goes on sending. So it does for
    `stands_s` before the start, by numbers below 0."""

    log: OdometryLog
    epoch_ns: int
    stands_s: float = 0.0
    _ways: dict[float, Array] = field(default_factory=dict)

    @property
    def period_s(self) -> float:
        return float(self.log.stamps_s[1] - self.log.stamps_s[0])

    def first_after(self, unix_ns: int) -> int:
        """The number of the first reading at or after a time."""
        elapsed_s = (unix_ns - self.epoch_ns) / NANOSECONDS
        number = int(np.ceil((elapsed_s - self.log.stamps_s[0]) / self.period_s))
        return max(self._earliest, number)

    def unix_ns(self, number: int) -> int:
        return self.epoch_ns + to_ns(float(self.log.stamps_s[0]) + number * self.period_s)

    def number(self, unix_ns: int) -> int:
        """The number of the last reading at or before a time, of the first one before that."""
        elapsed_s = (unix_ns - self.epoch_ns) / NANOSECONDS
        number = int(np.floor((elapsed_s - self.log.stamps_s[0]) / self.period_s + 1e-6))
        return max(self._earliest, number)

    @property
    def _earliest(self) -> int:
        return -int(self.stands_s / self.period_s)

    def pose(self, number: int) -> Pose:
        """odom_from_base."""
        return self.log.poses[min(max(number, 0), len(self.log.stamps_s) - 1)]

    def twist(self, number: int) -> tuple[Array, Array]:
        """Linear and angular speed over the last increment, base frame."""
        if not 0 < number < len(self.log.stamps_s):
            return np.zeros(3), np.zeros(3)
        step = self.pose(number - 1).inverse() @ self.pose(number)
        return step.translation / self.period_s, log(step.rotation) / self.period_s

    @cached_property
    def _steps(self) -> tuple[Array, Array]:
        """Each step's way along its arc, and its turn."""
        steps = increments(self.log.poses)
        turn = steps[:, 2]
        chord = steps[:, 0] * np.cos(turn / 2) + steps[:, 1] * np.sin(turn / 2)
        return chord / np.sinc(turn / 2 / np.pi), turn

    def wheels_m(self, unix_ns: int, track_m: float) -> tuple[float, float]:
        """How far the left and the right wheel have gone since the beginning, metres."""
        if track_m not in self._ways:
            way, turn = self._steps
            sides = np.stack([way - turn * track_m / 2, way + turn * track_m / 2])
            total = np.cumsum(sides, axis=1)
            self._ways[track_m] = np.column_stack([np.zeros(2), total])
        elapsed_s = (unix_ns - self.epoch_ns) / NANOSECONDS
        left, right = self._ways[track_m]
        stamps = self.log.stamps_s
        return float(np.interp(elapsed_s, stamps, left)), float(np.interp(elapsed_s, stamps, right))
