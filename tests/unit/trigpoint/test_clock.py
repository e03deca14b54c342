import threading

from trigpoint.clock import ManualClock, SystemClock, to_ns, to_seconds


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
