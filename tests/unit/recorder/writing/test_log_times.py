"""Log times by a clock that is set, and by one that is only read late."""

import pytest

from trigpoint.base.clock import SystemClock, to_ns
from trigpoint.recorder.writing.log_times import LogTimes

HELD_S = 0.3


class HeldClock(SystemClock):
    """A clock whose reader may be held by a busy machine, each time between two readings."""

    def __init__(self) -> None:
        self.elapsed_s, self.set_s = 100.0, 0.0
        self.held_after: str = ""

    def now_ns(self) -> int:
        return self._read("now") + to_ns(1e9 + self.set_s)

    def elapsed_ns(self) -> int:
        return self._read("elapsed")

    def _read(self, which: str) -> int:
        at_s = self.elapsed_s
        if which == self.held_after:
            self.elapsed_s += HELD_S
        return to_ns(at_s)


@pytest.mark.parametrize("held_after", ["now", "elapsed"])
def test_a_thread_that_is_held_between_two_clocks_sees_none_set(held_after: str) -> None:
    """Log times were later by that from then on, and the clock was noted to have been set."""
    clock = HeldClock()
    times = LogTimes(clock)
    clock.held_after = held_after
    times.look()
    clock.held_after = ""
    times.look()
    assert times.jumps == []
    assert times.now_ns() == clock.now_ns()


@pytest.mark.parametrize("by_s", [-60.0, 60.0])
def test_a_clock_that_is_set_is_seen(by_s: float) -> None:
    clock = HeldClock()
    times = LogTimes(clock)
    clock.set_s = by_s
    times.look()
    (jump,) = times.jumps
    assert jump.seconds == pytest.approx(by_s)
    assert times.now_ns() - clock.now_ns() == max(0, to_ns(-by_s))
