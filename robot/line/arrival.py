"""Estimates when a steady sender's readings were taken, from when they arrived.

A robot that sends every few milliseconds and says no times: its readings are evenly spaced, their
arrival is late by the line and by whatever held it up. The quickest arrivals of the last seconds
give the even line that all others are late against.
"""

from collections import deque

from trigpoint.base.clock import to_ns

_WINDOW_NS = to_ns(5.0)
# The period is tracked over this many readings, so that no single late one moves it: a clock fast
# by 100 ppm departs from the stated period by half a millisecond within the window.
_FOLLOWED = 1000
# A gap of this many periods is not jitter: the line starts anew.
_GAP_PERIODS = 20


class ArrivalClock:
    """`period_ns`: as the vendor states it; `line_ns`: transmission time of a reading."""

    def __init__(self, period_ns: int, line_ns: int) -> None:
        self._period_ns, self._line_ns = float(period_ns), line_ns
        self._nominal_ns = float(period_ns)
        # (arrival, its lateness against the even line from the first reading)
        self._late: deque[tuple[int, float]] = deque()
        self._even_ns = 0.0
        self._last_ns: int | None = None
        self._taken_ns = 0

    def taken_ns(self, arrived_ns: int) -> int:
        """When a reading was taken, given the arrival of its first byte."""
        steps = 1
        if self._last_ns is not None:
            steps = max(1, round((arrived_ns - self._even_ns) / self._period_ns))
        if self._last_ns is None or steps > _GAP_PERIODS:
            self._late.clear()
            self._even_ns = float(arrived_ns)
        else:
            elapsed_ns = (arrived_ns - self._last_ns) / steps
            if 0.5 < elapsed_ns / self._nominal_ns < 1.5:
                self._period_ns += (elapsed_ns - self._period_ns) / _FOLLOWED
            self._even_ns += steps * self._period_ns
        self._last_ns = arrived_ns
        self._late.append((arrived_ns, arrived_ns - self._even_ns))
        while self._late[0][0] < arrived_ns - _WINDOW_NS:
            self._late.popleft()
        least_ns = min(late for _, late in self._late)
        taken_ns = min(arrived_ns, round(self._even_ns + least_ns)) - self._line_ns
        self._taken_ns = max(taken_ns, self._taken_ns + 1)  # keep readings in order
        return self._taken_ns
