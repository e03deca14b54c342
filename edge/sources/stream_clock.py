"""When the pictures of a network stream were taken. Pure: no stream, no clock.

A picture's presentation time is on the sender's own scale, exact but of unknown origin. Its arrival
is later by what the way takes, and never earlier: so the least difference of late is the scale's
origin, but for the shortest way. Where RTCP tells the sender's time of day, and that is a time at
which the picture can have been taken, it is the better one.
"""

from collections import deque

from msgspec import Struct

from trigpoint.base.clock import to_ns

from .frames import Stamp

_WINDOW_NS = to_ns(10.0)
"""Two clocks of 100 ppm apart drift by a millisecond in it."""
_LONGEST_WAY_NS = to_ns(1.0)
"""From a picture's exposure to its arrival; a sender's clock that says more, or less than nothing,
is not set."""
_BROKEN_NS = to_ns(5.0)
"""A presentation time that is off by so much begins a new scale."""
_KEEPING_PACE = 3
_PACE = 0.5


class Arrival(Struct, frozen=True):
    """A picture's presentation time, its arrival by a monotonic clock, and where known the sender's
    Unix time of it; nanoseconds. `unix_ns`: what to add to the monotonic clock for Unix time."""

    presented_ns: int
    arrived_ns: int
    unix_ns: int
    sender_ns: int | None = None


class StreamClock:
    """One connection. `way_ns`: how long the way was known to take on an earlier one, which holds
    until the sender tells its time again."""

    def __init__(self, way_ns: int | None = None) -> None:
        self.way_ns = way_ns
        self._differences: deque[tuple[int, int]] = deque()  # (arrival, difference), rising
        self._last: Arrival | None = None
        self._paced = 0
        self._newest_ns: int | None = None

    def stamp(self, arrival: Arrival) -> tuple[int, Stamp] | None:
        """The Unix time at which a picture was taken, and how it is known; None for what the sender
        or the network had kept (until pictures come as slowly as they were taken), and for what is
        not later than the one before: a picture told twice, or one that the sender's first word of
        its time puts there."""
        origin_ns = self._origin_ns(arrival)
        if not self._keeps_pace(arrival):
            return None
        captured_ns, stamp = self._captured(arrival, origin_ns)
        if self._newest_ns is not None and 0 <= self._newest_ns - captured_ns <= _LONGEST_WAY_NS:
            return None
        self._newest_ns = captured_ns  # by more than the longest way: a clock that was set back
        return captured_ns, stamp

    def _captured(self, arrival: Arrival, origin_ns: int) -> tuple[int, Stamp]:
        arrival_ns = arrival.presented_ns + origin_ns + arrival.unix_ns
        if arrival.sender_ns is not None:
            way_ns = arrival_ns - arrival.sender_ns
            self.way_ns = way_ns if 0 <= way_ns <= _LONGEST_WAY_NS else None
        if self.way_ns is None:
            return arrival_ns, Stamp.ARRIVAL
        return arrival_ns - self.way_ns, Stamp.SENDER

    def _origin_ns(self, arrival: Arrival) -> int:
        """The least difference between arrival and presentation of late."""
        difference_ns = arrival.arrived_ns - arrival.presented_ns
        kept = self._differences
        if kept and abs(difference_ns - kept[0][1]) > _BROKEN_NS:
            kept.clear()
            self._last, self._paced = None, 0
        while kept and kept[-1][1] >= difference_ns:
            kept.pop()
        kept.append((arrival.arrived_ns, difference_ns))
        while kept[0][0] < arrival.arrived_ns - _WINDOW_NS:
            kept.popleft()
        return kept[0][1]

    def _keeps_pace(self, arrival: Arrival) -> bool:
        last, self._last = self._last, arrival
        if self._paced >= _KEEPING_PACE:
            return True
        if last is not None:
            came_ns = arrival.arrived_ns - last.arrived_ns
            taken_ns = arrival.presented_ns - last.presented_ns
            self._paced = self._paced + 1 if came_ns >= _PACE * taken_ns > 0 else 0
        return self._paced >= _KEEPING_PACE
