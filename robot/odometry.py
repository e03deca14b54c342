"""Readings of the firmware become messages of the bus: time, frame names, restarts."""

from collections import deque
from dataclasses import dataclass

from trigpoint.clock import to_ns
from trigpoint.geometry import Pose
from trigpoint.messages import Odometry

from .interpolation import between
from .protocol import Reading


@dataclass(frozen=True, slots=True)
class Stamped:
    """A published pose: `stamp_ns` Unix time, `firmware_ns` the firmware's clock then."""

    stamp_ns: int
    firmware_ns: int
    odom_from_base: Pose


class OdometryStream:
    """The robot's odometry frame on the bus, which never jumps.

    A restarted firmware counts from zero again, in an odometry frame of its own. The frame on the
    bus goes on: the first pose after the restart is put where the last one before it was. What the
    robot did in between is not known to anyone here; see decisions/0301-restarted-firmware.md.
    """

    def __init__(self, robot: str) -> None:
        self._frame, self._child = f"{robot}/odom", f"{robot}/base"
        self._odom_from_counted = Pose.identity()
        self._is_restarted = False
        self._last: Stamped | None = None

    @property
    def last(self) -> Stamped | None:
        """What was published last."""
        return self._last

    def restart(self) -> None:
        """The firmware was restarted: what it counts now begins where the robot was last."""
        self._is_restarted = self._last is not None

    def add(self, reading: Reading, stamp_ns: int) -> Odometry | None:
        """The message of a reading; None where its time is not after the last one's."""
        if self._last is not None and stamp_ns <= self._last.stamp_ns:
            return None
        if self._is_restarted and self._last is not None:
            self._odom_from_counted = self._last.odom_from_base @ reading.pose.inverse()
            self._is_restarted = False
        pose = self._odom_from_counted @ reading.pose
        self._last = Stamped(stamp_ns, reading.firmware_ns, pose)
        return Odometry(
            stamp_ns, self._frame, self._child, pose, reading.linear.copy(), reading.angular.copy()
        )


class OdometryHistory:
    """The last few seconds of what was published, to look up a moment in."""

    def __init__(self, span_s: float) -> None:
        self._span_ns = to_ns(span_s)
        self._entries: deque[Stamped] = deque()

    def add(self, entry: Stamped) -> None:
        """Append the newest."""
        self._entries.append(entry)
        while self._entries[0].stamp_ns < entry.stamp_ns - self._span_ns:
            self._entries.popleft()

    def clear(self) -> None:
        """Forget everything: the firmware's clock and frame are others now."""
        self._entries.clear()

    def at(self, stamp_ns: int) -> Stamped | None:
        """The robot at a moment, between the two readings about it; None outside of the history."""
        later: Stamped | None = None
        for entry in reversed(self._entries):
            if entry.stamp_ns <= stamp_ns:
                return _between(entry, later, stamp_ns)
            later = entry
        return None

    def after(self, stamp_ns: int) -> list[Stamped]:
        """The readings after a moment, in order."""
        return [entry for entry in self._entries if entry.stamp_ns > stamp_ns]


def _between(earlier: Stamped, later: Stamped | None, stamp_ns: int) -> Stamped | None:
    if earlier.stamp_ns == stamp_ns:
        return earlier
    if later is None:
        return None
    fraction = (stamp_ns - earlier.stamp_ns) / (later.stamp_ns - earlier.stamp_ns)
    firmware_ns = earlier.firmware_ns + round(fraction * (later.firmware_ns - earlier.firmware_ns))
    pose = between(earlier.odom_from_base, later.odom_from_base, fraction)
    return Stamped(stamp_ns, firmware_ns, pose)
