"""Clocks: what time it is, and waiting; handed in, so that tests decide."""

import threading
import time
from typing import Protocol

NANOSECONDS = 1_000_000_000


class Clock(Protocol):
    """A source of time."""

    def now_ns(self) -> int:
        """Unix time, nanoseconds; comparable between machines as far as they are synchronised."""
        ...

    def elapsed_ns(self) -> int:
        """Monotonic time, nanoseconds, for durations on this machine."""
        ...

    def wait(self, event: threading.Event, timeout_s: float) -> bool:
        """Wait until `event` is set or the time is over; return whether it is set."""
        ...


class SystemClock:
    """The machine's clock."""

    def now_ns(self) -> int:
        return time.time_ns()

    def elapsed_ns(self) -> int:
        return time.monotonic_ns()

    def wait(self, event: threading.Event, timeout_s: float) -> bool:
        return event.wait(timeout_s)


class ManualClock:
    """A clock that stands until a test moves it; waiting moves it at once."""

    def __init__(self, start_ns: int = 0) -> None:
        self._now_ns = start_ns

    def now_ns(self) -> int:
        return self._now_ns

    def elapsed_ns(self) -> int:
        return self._now_ns

    def advance(self, seconds: float) -> None:
        """Move the clock forward."""
        self._now_ns += to_ns(seconds)

    def wait(self, event: threading.Event, timeout_s: float) -> bool:
        if not event.is_set():
            self.advance(timeout_s)
        return event.is_set()


def to_ns(seconds: float) -> int:
    """Seconds as integer nanoseconds."""
    return round(seconds * NANOSECONDS)


def to_seconds(nanoseconds: int) -> float:
    """Nanoseconds as seconds; only for differences, since a Unix time in float keeps 200 ns."""
    return nanoseconds / NANOSECONDS
