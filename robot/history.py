"""The last few seconds of the published odometry: where the robot was, and how errors grew."""

from collections import deque
from dataclasses import dataclass

from trigpoint.clock import to_ns
from trigpoint.config import OdometryNoise

from .interpolation import between
from .odometry import Stamped
from .reckoning import Step, step_between


@dataclass(frozen=True, slots=True)
class _Entry:
    """A reading, and the step that led to it from the one before."""

    at: Stamped
    step: Step | None


class OdometryHistory:
    """Looked up by moment; not thread-safe."""

    def __init__(self, span_s: float, noise: OdometryNoise) -> None:
        self._span_ns, self._noise = to_ns(span_s), noise
        self._entries: deque[_Entry] = deque()

    @property
    def last(self) -> Stamped | None:
        """The newest reading."""
        return self._entries[-1].at if self._entries else None

    def add(self, at: Stamped) -> None:
        """Append the newest."""
        last = self.last
        step = last and step_between(last.odom_from_base, at.odom_from_base, self._noise)
        self._entries.append(_Entry(at, step))
        while self._entries[0].at.stamp_ns < at.stamp_ns - self._span_ns:
            self._entries.popleft()

    def clear(self) -> None:
        """Forget everything: the firmware's clock and frame are others now."""
        self._entries.clear()

    def at(self, stamp_ns: int) -> Stamped | None:
        """The robot at a moment, between the two readings about it; None outside of the history."""
        later: Stamped | None = None
        for entry in reversed(self._entries):
            if entry.at.stamp_ns <= stamp_ns:
                return _between(entry.at, later, stamp_ns)
            later = entry.at
        return None

    def steps(self, begin: Stamped, end: Stamped) -> list[Step]:
        """The way from one moment to a later one, neither of which need be a reading's."""
        inner = self._inner(begin.stamp_ns, end.stamp_ns)
        if not inner:
            return [step_between(begin.odom_from_base, end.odom_from_base, self._noise)]
        first, last = inner[0].at, inner[-1].at
        found = [step_between(begin.odom_from_base, first.odom_from_base, self._noise)]
        found += [entry.step for entry in inner[1:] if entry.step is not None]
        if last.stamp_ns < end.stamp_ns:
            found.append(step_between(last.odom_from_base, end.odom_from_base, self._noise))
        return found

    def _inner(self, begin_ns: int, end_ns: int) -> list[_Entry]:
        """The readings after `begin_ns`, up to `end_ns`, in order."""
        found = []
        for entry in reversed(self._entries):
            if entry.at.stamp_ns <= begin_ns:
                break
            if entry.at.stamp_ns <= end_ns:
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
