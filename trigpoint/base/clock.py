"""Clocks: reading the time, and waiting; passed in, so that tests can control them."""

import threading
import time
from collections.abc import Callable
from typing import Protocol

NANOSECONDS = 1_000_000_000
STEP_NS = 10_000_000
"""A clock that is off from its course by this much was set: the kernel slews smaller offsets, which
moves the monotonic clock as well."""
SETTLED_NS = 10 * NANOSECONDS
"""A clock that was set is trusted once it has stayed so for this long."""


class Clock(Protocol):
    """A source of time."""

    def now_ns(self) -> int:
        """Unix time, nanoseconds; comparable between machines if they are synchronised."""
        ...

    def elapsed_ns(self) -> int:
        """Monotonic time, nanoseconds, for durations on this machine."""
        ...

    def wait(self, event: threading.Event, timeout_s: float) -> bool:
        """Wait until `event` is set, or time out; return whether it is set."""
        ...


def ahead_of_elapsed_ns(
    unix_ns: Callable[[], int], elapsed_ns: Callable[[], int]
) -> tuple[int, int]:
    """The bounds of Unix time minus the monotonic clock, from the closest of a few pairs of
    readings: a busy machine may hold a thread between two."""
    readings = [(elapsed_ns(), unix_ns(), elapsed_ns()) for _ in range(5)]
    before_ns, now_ns, after_ns = min(readings, key=lambda each: each[2] - each[0])
    return now_ns - after_ns, now_ns - before_ns


class SystemClock:
    """The machine's clock."""

    def now_ns(self) -> int:
        return time.time_ns()

    def elapsed_ns(self) -> int:
        return time.monotonic_ns()

    def wait(self, event: threading.Event, timeout_s: float) -> bool:
        return event.wait(timeout_s)


class SteadyClock:
    """The machine's clock for stamps that must not jump when somebody, or NTP, sets it.

    It carries on by monotonic time and reports by how much the machine's clock was set
    (`set_by_ns`). If that stays so for ten seconds, the new time is trusted and followed;
    `followed` counts this. (A small computer without a battery-backed clock starts with the last
    time that it knew.) Any thread.
    """

    def __init__(
        self,
        unix_ns: Callable[[], int] = time.time_ns,
        elapsed_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._unix_ns, self._elapsed_ns = unix_ns, elapsed_ns
        self._offset_ns = self._measured_ns()
        self._lock = threading.Lock()
        self._set_by_ns = 0
        self._since_ns = 0
        self.followed = 0

    def now_ns(self) -> int:
        return self._elapsed_ns() + self._offset_ns

    def elapsed_ns(self) -> int:
        return self._elapsed_ns()

    def wait(self, event: threading.Event, timeout_s: float) -> bool:
        return event.wait(timeout_s)

    def look(self) -> int:
        """Check whether the machine's clock was set; call it about once a second. Returns by how
        much it was set, ns; 0 if it was not, or is followed by now."""
        with self._lock:
            moved_ns = self._measured_ns() - self._offset_ns
            now_ns = self._elapsed_ns()
            if abs(moved_ns) < STEP_NS:
                self._set_by_ns = 0
            elif abs(moved_ns - self._set_by_ns) >= STEP_NS:  # set, perhaps again
                self._set_by_ns, self._since_ns = moved_ns, now_ns
            elif now_ns - self._since_ns >= SETTLED_NS:
                self._offset_ns += moved_ns
                self._set_by_ns = 0
                self.followed += 1
            return self._set_by_ns

    @property
    def set_by_ns(self) -> int:
        """The last result of `look`."""
        return self._set_by_ns

    def _measured_ns(self) -> int:
        return sum(ahead_of_elapsed_ns(self._unix_ns, self._elapsed_ns)) // 2


class ManualClock:
    """A clock that stands still until a test moves it; waiting moves it at once."""

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
    """Nanoseconds as seconds; only for differences: a float resolves Unix time to 200 ns."""
    return nanoseconds / NANOSECONDS
