"""A robot's odometry without the noise that it shows while the robot stands.

At rest encoders repeat one reading, but a gyroscope's heading wanders and creeps by its bias, and a
fused pose trembles. All of that leads nowhere: n steps of noise end about √n steps from where they
began, those of a drive n steps. So a robot stands while its last readings lie no further apart than
noise of the steps' size can take them; then its pose is the one that it came to rest with. Where
readings repeat exactly nothing is noise, and every step is motion.
"""

import math
from collections import deque
from typing import NamedTuple

from trigpoint.base.clock import NANOSECONDS, to_ns
from trigpoint.geometry import Pose

RECENT_S = 2.0
"""Over so long a robot must have stood until what its readings show counts as noise."""
_LEAST_READINGS = 16
# Of √n steps; a random walk comes further within n steps once in a thousand.
_SCATTERS = 3.0
# Noise that is larger is none of a robot at rest: m, rad.
_MOST_PLACE, _MOST_TURN = 0.01, math.radians(1)
# By how much a gyroscope's heading may creep: ten times the bias of cheap ones (MPU-6050: 30°/h
# after a start). No robot turns as slowly.
_BIAS = math.radians(0.1)  # rad/s
# Over a longer silence than this, and than so many of the intervals before, nothing is noise.
_GAP_NS, _GAP_INTERVALS = to_ns(1.0), 3
_RECENT_NS, _ROOT_OF_2 = to_ns(RECENT_S), math.sqrt(2)


class _Reading(NamedTuple):
    """A pose, also as plain numbers, and how far it is from the one before: m, rad."""

    stamp_ns: int
    pose: Pose
    place: list[float]
    turn: list[float]
    step: tuple[float, float]

    def apart(self, other: "_Reading") -> tuple[float, float]:
        """How far two readings are apart: m, rad."""
        return _apart(self.place, self.turn, other)


def _apart(place: list[float], turn: list[float], other: _Reading) -> tuple[float, float]:
    """How far a pose is from a reading: m, rad (by the chord between their rotations)."""
    return math.dist(place, other.place), math.dist(turn, other.turn) / _ROOT_OF_2


class Rest:
    """One robot's reported poses, in order. Not thread-safe."""

    def __init__(self) -> None:
        self._recent = deque[_Reading]()
        self._anchor: _Reading | None = None  # where it came to rest, while it stands
        self._held: Pose = Pose.identity()
        self._noise = (0.0, 0.0)
        self._frame: Pose | None = None  # of the robot's odometry, in ours
        self._interval_ns = 0

    @property
    def trembles(self) -> bool:
        """Whether the robot stands, and its readings show noise."""
        return self._anchor is not None and any(self._noise)

    def add(self, stamp_ns: int, pose: Pose) -> Pose:
        """The pose of a reading, in a frame in which noise at rest has not moved the robot; stamps
        rise."""
        reading = self._read(stamp_ns, pose)
        if self._anchor is not None and not self._has_left(self._anchor, reading):
            self._recent.append(reading)
            return self._held
        if self._anchor is not None:
            self._leave(self._anchor)
        self._recent.append(reading)
        found = pose if self._frame is None else self._frame @ pose
        noise = self._noise_at_rest()
        if noise is not None:
            self._anchor, self._held, self._noise = reading, found, noise
            self._recent = deque([reading])
        return found

    def _read(self, stamp_ns: int, pose: Pose) -> _Reading:
        """The reading, after those of the same rest or drive that are recent."""
        place, turn = pose.translation.tolist(), pose.rotation.ravel().tolist()
        if not self._recent:
            return _Reading(stamp_ns, pose, place, turn, (0.0, 0.0))
        last = self._recent[-1]
        interval_ns = stamp_ns - last.stamp_ns
        if interval_ns > max(_GAP_NS, _GAP_INTERVALS * self._interval_ns):
            if self._anchor is not None:
                self._recent = deque([last])
                self._leave(self._anchor)
            self._recent.clear()
        while len(self._recent) > 1 and stamp_ns - self._recent[0].stamp_ns > _RECENT_NS:
            self._recent.popleft()
        self._interval_ns = interval_ns
        return _Reading(stamp_ns, pose, place, turn, _apart(place, turn, last))

    def _has_left(self, anchor: _Reading, reading: _Reading) -> bool:
        first = self._recent[0]
        place, turn = self._noise
        if not any(self._noise):
            return any(reading.step)
        creep = _BIAS * (reading.stamp_ns - first.stamp_ns) / NANOSECONDS
        return reading.apart(anchor)[0] > place or reading.apart(first)[1] > turn + creep

    def _leave(self, anchor: _Reading) -> None:
        """Go on from where the robot stood. Whatever led away from there was motion; of the turn,
        only what the last readings show: before that it was a gyroscope's creeping."""
        self._anchor = None
        turn = self._recent[0].pose.rotation
        if any(self._noise):
            self._frame = self._held @ Pose(turn, anchor.pose.translation).inverse()

    def _noise_at_rest(self) -> tuple[float, float] | None:
        """How far noise may take a reading, m and rad, if all recent ones lie so near; else None,
        since the robot drives, or it cannot be told."""
        recent, first = self._recent, self._recent[0]
        seconds = (recent[-1].stamp_ns - first.stamp_ns) / NANOSECONDS
        span = recent[-1].apart(first)
        if span[0] > _MOST_PLACE or span[1] > _MOST_TURN + _BIAS * seconds:
            return None
        if len(recent) < _LEAST_READINGS or seconds < RECENT_S / 2:
            return None
        # The first and the last steps may be those of a drive, and then say nothing of noise.
        quarter = len(recent) // 4
        steps = [reading.step for reading in recent][quarter:-quarter]
        place, turn = (
            min(_SCATTERS * math.sqrt(sum(step[k] ** 2 for step in steps) * 2), most)
            for k, most in ((0, _MOST_PLACE), (1, _MOST_TURN))
        )
        creep = _BIAS * seconds if turn else 0.0
        spans = [reading.apart(first) for reading in recent]
        is_near = all(s[0] <= place and s[1] <= turn + creep for s in spans)
        return (place, turn) if is_near else None
