"""Log times that never step back, by a clock that may."""

from msgspec import Struct

from trigpoint.base.clock import Clock, ahead_of_elapsed_ns, to_ns
from trigpoint.recorder.mcap.writer import Message

_JUMP_NS = to_ns(0.05)
"""A clock kept by NTP slews at most half a millisecond per second, and it is checked ten times a
second. A hundred times that is a step."""


class ClockJump(Struct, frozen=True):
    """The machine's clock was set: by `seconds`, at a log time."""

    log_ns: int
    seconds: float


class LogTimes:
    """Converts the machine's times to log times: the same until the clock is set back; from then on
    later by that amount, so that they continue at the clock's pace."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._offset_ns = 0
        self._step_ns, _ = ahead_of_elapsed_ns(clock.now_ns, clock.elapsed_ns)
        self.jumps: list[ClockJump] = []

    def look(self) -> None:
        """Check whether the clock was set; call it often."""
        least_ns, most_ns = ahead_of_elapsed_ns(self._clock.now_ns, self._clock.elapsed_ns)
        step_ns = min(max(self._step_ns, least_ns), most_ns)
        jump_ns, self._step_ns = step_ns - self._step_ns, step_ns
        if abs(jump_ns) > _JUMP_NS:
            self._offset_ns = max(0, self._offset_ns - jump_ns)
            self.jumps.append(ClockJump(self.now_ns(), jump_ns / 1e9))

    def now_ns(self) -> int:
        """The current log time."""
        return self._clock.now_ns() + self._offset_ns

    def of_all(self, messages: list[Message], now_ns: int) -> list[Message]:
        """The messages with log times in place of their times of arrival; none is later than
        `now_ns`, the current log time."""
        offset_ns = self._offset_ns
        if not offset_ns:
            return messages
        return [m._replace(log_ns=min(m.log_ns + offset_ns, now_ns)) for m in messages]
