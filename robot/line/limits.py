"""Motion that a robot cannot have made, by its stated limits.

A wrapped or reset counter, a controller that restarted silently, a corrupt number: each shows as a
step that no motor makes. Such a reading is refused. If the following readings agree with one
another, the count restarted elsewhere: a new epoch, which continues from the last good pose.
"""

import math
from enum import Enum

import numpy as np

from trigpoint.base.clock import to_seconds
from trigpoint.geometry import Pose
from trigpoint.site.config import RobotConfig

# A site is a building; anything beyond is a corrupt number.
FURTHEST_M = 100e3
# Possible error of the time between two stamps, beside what is known of each: a reading that waited
# for the previous one.
JITTER_S = 0.02
# This many readings in a row must agree; at 50 Hz a tenth of a second is lost.
AGREEING = 5


class Motion(Enum):
    """How a reading relates to the previous one."""

    POSSIBLE = "possible"
    IMPOSSIBLE = "impossible"
    NEW_EPOCH = "new epoch"


_Reading = tuple[int, Pose, int]
"""A stamp, the pose then, and how far off the stamp may be, nanoseconds."""


class MotionLimits:
    """Checks one robot's readings in order. Not thread-safe."""

    def __init__(self, config: RobotConfig) -> None:
        self._speed, self._turn = config.max_speed, config.max_turn
        self._last: _Reading | None = None
        self._doubted: _Reading | None = None
        self._agreeing = 0

    def restart(self) -> None:
        """The next reading may be anywhere."""
        self._last = self._doubted = None

    def look(self, stamp_ns: int, pose: Pose, doubt_ns: int = 0) -> Motion:
        """Whether the robot can have moved so since the last good reading; `doubt_ns`: how far off
        the stamp may be."""
        reading = (stamp_ns, pose, doubt_ns)
        if not np.max(np.abs(pose.translation)) < FURTHEST_M:
            return Motion.IMPOSSIBLE
        if self._last is None or self._is_possible(self._last, reading):
            self._last, self._doubted = reading, None
            return Motion.POSSIBLE
        doubted, self._doubted = self._doubted, reading
        agrees = doubted is not None and self._is_possible(doubted, reading)
        self._agreeing = self._agreeing + 1 if agrees else 1
        if self._agreeing < AGREEING:
            return Motion.IMPOSSIBLE
        self._last, self._doubted = reading, None
        return Motion.NEW_EPOCH

    def _is_possible(self, before: _Reading, after: _Reading) -> bool:
        doubt_s = JITTER_S + to_seconds(before[2] + after[2])
        allowed_s = max(0.0, to_seconds(after[0] - before[0])) + doubt_s
        if math.dist(after[1].translation, before[1].translation) > self._speed * allowed_s:
            return False
        return _angle_between(before[1], after[1]) <= self._turn * allowed_s


def _angle_between(first: Pose, second: Pose) -> float:
    """`pose.angle_between` of two single poses, by plain numbers: this runs at every reading."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = (first.rotation.T @ second.rotation).tolist()
    return math.atan2(math.hypot(zy - yz, xz - zx, yx - xy), xx + yy + zz - 1)
