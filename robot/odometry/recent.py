"""The last few seconds of published odometry: where the robot was, and how errors grew."""

from collections import deque

from trigpoint.base.clock import to_ns
from trigpoint.geometry import Pose
from trigpoint.site.config import OdometryNoise

from .interpolation import between
from .odometry import Stamped
from .reckoning import Step, steps_along


class OdometryHistory:
    """Looked up by time stamp; not thread-safe."""

    def __init__(self, span_s: float, noise: OdometryNoise) -> None:
        self._span_ns, self._noise = to_ns(span_s), noise
        self._entries: deque[Stamped] = deque()

    @property
    def last(self) -> Stamped | None:
        """The newest reading."""
        return self._entries[-1] if self._entries else None

    def add(self, at: Stamped) -> None:
        """Append the newest reading."""
        self._entries.append(at)
        while self._entries[0].stamp_ns < at.stamp_ns - self._span_ns:
            self._entries.popleft()

    def clear(self) -> None:
        """Forget everything: the firmware's clock and frame have changed."""
        self._entries.clear()

    def at(self, stamp_ns: int) -> Stamped | None:
        """The robot at a moment, interpolated between readings; None outside the history."""
        later: Stamped | None = None
        for entry in reversed(self._entries):
            if entry.stamp_ns <= stamp_ns:
                return _between(entry, later, stamp_ns)
            later = entry
        return None

    def steps(self, begin: Stamped, end: Stamped) -> list[Step]:
        """The motion from one moment to a later one; neither needs to be that of a reading."""
        way = [begin, *self._inner(begin.stamp_ns, end.stamp_ns), end]
        return steps_along(Pose.stack([entry.odom_from_base for entry in way]), self._noise)

    def _inner(self, begin_ns: int, end_ns: int) -> list[Stamped]:
        """The readings between two moments, in order."""
        found: list[Stamped] = []
        for entry in reversed(self._entries):
            if entry.stamp_ns <= begin_ns:
                break
            if entry.stamp_ns < end_ns:
                found.append(entry)
        return found[::-1]


def _between(earlier: Stamped, later: Stamped | None, stamp_ns: int) -> Stamped | None:
    if earlier.stamp_ns == stamp_ns:
        return earlier
    if later is None:
        return None
    fraction = (stamp_ns - earlier.stamp_ns) / (later.stamp_ns - earlier.stamp_ns)
    firmware_ns = earlier.firmware_ns + round(fraction * (later.firmware_ns - earlier.firmware_ns))
    pose = between(earlier.odom_from_base, later.odom_from_base, fraction)
    return Stamped(stamp_ns, firmware_ns, pose)
