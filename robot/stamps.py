"""When readings were taken: by the firmware's clock, by their arrival, or by what they say."""

from dataclasses import dataclass

from trigpoint.clock import Clock, to_ns, to_seconds
from trigpoint.health import Health

from .firmware_clock import FirmwareClock
from .protocol import Reading, StampClock

# Two machines without NTP are seconds apart; more is a clock that was never set.
_CLOCKS_APART_NS = to_ns(5.0)
_STEP_NS = to_ns(0.01)
# On a busy machine exchanges take tens of milliseconds, and half of that is how well the firmware's
# clock is known: what seems to be of after its arrival was taken just before.
_DOUBT_NS = to_ns(0.05)


@dataclass(frozen=True, slots=True)
class Offset:
    """What turns this machine's monotonic clock into Unix time: nanoseconds to add.

    Taken anew only where a clock that was set is believed: stamps must not jump as it is set.
    """

    unix_minus_elapsed_ns: int


def measured_offset(clock: Clock) -> Offset:
    """Unix time minus the monotonic clock, from the tightest of a few pairs of readings."""
    best_ns, offset_ns = None, 0
    for _ in range(5):
        before_ns, now_ns, after_ns = clock.elapsed_ns(), clock.now_ns(), clock.elapsed_ns()
        if best_ns is None or after_ns - before_ns < best_ns:
            best_ns = after_ns - before_ns
            offset_ns = now_ns - (before_ns + after_ns) // 2
    return Offset(offset_ns)


class Stamps:
    """One robot's; `source`: the clock that its readings are stamped by. Not thread-safe."""

    def __init__(self, robot: str, source: StampClock, offset: Offset, health: Health) -> None:
        self._robot, self._source, self._offset, self._health = robot, source, offset, health
        self.clock = FirmwareClock()
        self.ahead_s = 0.0
        """How far a robot's own Unix time was ahead of ours when its newest reading came."""

    def unix_ns(self, elapsed_ns: int) -> int:
        """Unix time on the scale of the stamps."""
        return elapsed_ns + self._offset.unix_minus_elapsed_ns

    def follow(self, clock: Clock) -> int:
        """Stamp by `clock` as it goes now, where it was set; what it was set by, nanoseconds."""
        offset = measured_offset(clock)
        moved_ns = offset.unix_minus_elapsed_ns - self._offset.unix_minus_elapsed_ns
        if abs(moved_ns) <= _STEP_NS:
            return 0
        self._offset = offset
        return moved_ns

    def of(self, reading: Reading) -> int | None:
        """When the reading was taken; None where that cannot be told or be true."""
        match self._source:
            case StampClock.UNIX:
                return self._own(reading)
            case StampClock.MACHINE:
                machine_ns = reading.firmware_ns
            case StampClock.FIRMWARE:
                machine_ns = self.clock.machine_ns(reading.firmware_ns)
        if machine_ns is None:
            self._health.count("odometry_before_clock")
            return None
        if machine_ns > reading.received_ns + _DOUBT_NS:
            # The firmware's clock was set: such a stamp would make all later readings out of order.
            self._health.lose("odometry_ahead_of_clock")
            return None
        return self.unix_ns(min(machine_ns, reading.received_ns))

    def _own(self, reading: Reading) -> int | None:
        """A robot's own Unix time: it need not be ours, but far off nothing of it can be used."""
        off_ns = reading.firmware_ns - self.unix_ns(reading.received_ns)
        self.ahead_s = to_seconds(off_ns)
        if abs(off_ns) <= _CLOCKS_APART_NS:
            return reading.firmware_ns
        self._health.lose("odometry_clock_off")
        self._health.fail(
            f"odometry of robot {self._robot} is stamped {self.ahead_s:+.1f} s from this "
            "machine's clock; synchronise the two (chrony)"
        )
        return None
