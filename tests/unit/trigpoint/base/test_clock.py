import threading

import pytest

from trigpoint.base.clock import ManualClock, SteadyClock, SystemClock, to_ns, to_seconds


def test_manual_clock_moves_only_when_told_or_waited_on() -> None:
    clock = ManualClock(1_000)
    assert clock.now_ns() == clock.elapsed_ns() == 1_000
    clock.advance(1.5)
    assert clock.now_ns() == 1_500_001_000
    assert not clock.wait(threading.Event(), 0.5)
    assert clock.now_ns() == 2_000_001_000


def test_manual_clock_does_not_wait_for_what_is_there() -> None:
    clock, event = ManualClock(), threading.Event()
    event.set()
    assert clock.wait(event, 10.0)
    assert clock.now_ns() == 0


def test_system_clock_goes_forward_and_wakes_for_an_event() -> None:
    clock, event = SystemClock(), threading.Event()
    start = clock.elapsed_ns()
    assert not clock.wait(event, 0.001)
    assert clock.elapsed_ns() > start
    event.set()
    assert clock.wait(event, 60.0)


def test_seconds_and_nanoseconds() -> None:
    assert to_ns(1.25) == 1_250_000_000
    assert to_seconds(1_250_000_000) == 1.25


class SetClock:
    """A machine's clock, which somebody sets."""

    def __init__(self) -> None:
        self.elapsed = to_ns(50.0)
        self.offset = to_ns(1e9)
        self.clock = SteadyClock(lambda: self.elapsed + self.offset, lambda: self.elapsed)

    def go_on(self, seconds: float, looks: int = 1) -> None:
        for _ in range(looks):
            self.elapsed += to_ns(seconds)
            self.clock.look()


@pytest.mark.parametrize("step_s", [-10.0, 10.0, -3600.0])
def test_clock_that_is_set_is_said_carried_on_from_and_followed_later(step_s: float) -> None:
    machine = SetClock()
    machine.go_on(1.0, 5)
    before_ns = machine.clock.now_ns()
    machine.offset += to_ns(step_s)
    machine.go_on(1.0)
    assert machine.clock.set_by_ns == to_ns(step_s)
    assert machine.clock.now_ns() == before_ns + to_ns(1.0)
    machine.go_on(1.0, 9)
    assert (machine.clock.followed, machine.clock.now_ns()) == (0, before_ns + to_ns(10.0))
    machine.go_on(1.0)
    assert (machine.clock.followed, machine.clock.set_by_ns) == (1, 0)
    assert machine.clock.now_ns() == before_ns + to_ns(11.0 + step_s)


def test_clock_that_is_set_right_again_was_never_followed() -> None:
    machine = SetClock()
    machine.offset += to_ns(10.0)
    machine.go_on(1.0, 5)
    machine.offset -= to_ns(10.0)
    machine.go_on(1.0, 20)
    assert (machine.clock.followed, machine.clock.set_by_ns) == (0, 0)
    assert machine.clock.now_ns() == machine.elapsed + machine.offset
