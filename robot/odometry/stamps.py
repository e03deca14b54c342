"""When readings were taken: by the firmware's clock, by arrival, or by their own stamps."""

from msgspec import Struct

from trigpoint.base.clock import Clock, ahead_of_elapsed_ns, to_ns, to_seconds
from trigpoint.contract.messages import Mended
from trigpoint.node.health import Health, mended_count
from trigpoint.robot.line.firmware_clock import FirmwareClock
from trigpoint.robot.line.protocol import Reading, StampClock

# Two machines without NTP are seconds apart; beyond this a clock was never set.
_CLOCKS_APART_NS = to_ns(5.0)
_STEP_NS = to_ns(0.01)
# On a busy machine exchanges take tens of milliseconds, and the firmware's clock is known only to
# half of that: a reading stamped after its arrival was taken just before it.
_DOUBT_NS = to_ns(0.05)


class Offset(Struct, frozen=True):
    """Nanoseconds to add to this machine's monotonic clock to get Unix time.

    Measured again only once a newly set clock is trusted: stamps must not jump when it is set.
    """

    unix_minus_elapsed_ns: int


def measured_offset(clock: Clock) -> Offset:
    """Unix time minus the monotonic clock."""
    return Offset(sum(ahead_of_elapsed_ns(clock.now_ns, clock.elapsed_ns)) // 2)


class Stamps:
    """One robot's stamps; `source`: the clock of its readings. Not thread-safe."""

    def __init__(self, robot: str, source: StampClock, offset: Offset, health: Health) -> None:
        self._robot, self._source, self._offset, self._health = robot, source, offset, health
        self.clock = FirmwareClock()
        self.ahead_s = 0.0
        """How far a robot's own Unix time was ahead of ours when its newest reading came."""

    def unix_ns(self, elapsed_ns: int) -> int:
        """Unix time on the time scale of the stamps."""
        return elapsed_ns + self._offset.unix_minus_elapsed_ns

    def follow(self, clock: Clock) -> int:
        """Follow `clock` if it was set; return by how much, nanoseconds."""
        offset = measured_offset(clock)
        moved_ns = offset.unix_minus_elapsed_ns - self._offset.unix_minus_elapsed_ns
        if abs(moved_ns) <= _STEP_NS:
            return 0
        self._offset = offset
        return moved_ns

    def of(self, reading: Reading) -> int | None:
        """When the reading was taken; None if that is unknown or impossible."""
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
            # The firmware's clock was set: this stamp would put all later readings out of order.
            self._health.lose("odometry_ahead_of_clock")
            return None
        return self.unix_ns(min(machine_ns, reading.received_ns))

    def _own(self, reading: Reading) -> int | None:
        """A robot's own Unix time: it may differ from ours, but a stamp far off is unusable."""
        if reading.firmware_ns == 0:
            self._health.count(mended_count(Mended.UNSTAMPED))
            return self.unix_ns(reading.received_ns)
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
