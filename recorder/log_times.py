"""Log times that never step back, by a clock that may."""

from dataclasses import dataclass

from trigpoint.clock import Clock, to_ns

from .sink_queue import Message

_JUMP_NS = to_ns(0.05)
"""A clock that is kept by NTP slews half a millisecond a second at most; a look comes ten times a
second. What is a hundred times more is a step."""


@dataclass(frozen=True, slots=True)
class ClockJump:
    """The machine's clock was set: by `seconds`, at a log time."""

    log_ns: int
    seconds: float


class LogTimes:
    """Turns the machine's times into log times: the same, until the clock is set back; from then
    on later by as much, so that they go on at the clock's pace."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._offset_ns = 0
        self._step_ns = clock.now_ns() - clock.elapsed_ns()
        self.jumps: list[ClockJump] = []

    def look(self) -> None:
        """Notice whether the clock was set; call it often."""
        step_ns = self._clock.now_ns() - self._clock.elapsed_ns()
        jump_ns, self._step_ns = step_ns - self._step_ns, step_ns
        if abs(jump_ns) > _JUMP_NS:
            self._offset_ns = max(0, self._offset_ns - jump_ns)
            self.jumps.append(ClockJump(self.now_ns(), jump_ns / 1e9))

    def now_ns(self) -> int:
        """The log time of now."""
        return self._clock.now_ns() + self._offset_ns

    def of_all(self, messages: list[Message], now_ns: int) -> list[Message]:
        """The messages with log times in place of the times at which they were received; `now_ns`:
        the log time of now, which none is after."""
        offset_ns = self._offset_ns
        if not offset_ns:
            return messages
        return [m._replace(log_ns=min(m.log_ns + offset_ns, now_ns)) for m in messages]
