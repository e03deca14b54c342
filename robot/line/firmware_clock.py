"""Maps the firmware's clock to this machine's time.

The firmware stamps its readings with a clock of its own, which starts anywhere and runs some
parts per million fast or slow. Each exchange (`ClockExchange`) bounds it: the firmware read its
clock after we asked and before we had the answer. The middle of the two is wrong by at most half
the round trip; an exchange that took longer than the quickest ones was held up on one way or the
other, by an unknown part of the excess. So a straight line is fitted through the middles of a
sliding window, each weighted by what its excess over the shortest round trip allows (the idea is
NTP's clock filter, Mills, RFC 5905, section 10; the weighted line replaces its choice of one).
"""

from collections import deque

import numpy as np
from msgspec import Struct

from trigpoint.base.clock import to_ns

from .protocol import ClockExchange

WINDOW_NS = to_ns(60.0)
# Half the shortest round trip is the most that the first stamps can be wrong by. A line of 115 200
# baud takes 5 ms, the same both ways. Where all took longer than this (on a busy machine the first
# stamps were 120 ms wrong), they wait for the best of the first burst.
NEEDED = 4
QUICK_NS = to_ns(0.01)
NEEDED_SLOW = 10
# Crystals are good to 20 … 50 ppm, cheap resonators are worse.
DRIFT_SIGMA = 100e-6
# Scheduling noise of a quick exchange; keeps weights finite.
FLOOR_NS = 20_000.0
# A firmware clock that jumps without a restart is accepted after this many exchanges in a row.
CONTRADICTIONS = 3
CONTRADICTION_NS = to_ns(0.001)


class _Line(Struct, frozen=True):
    """machine = firmware + offset + drift · (firmware - origin), nanoseconds."""

    origin_ns: int
    offset_ns: int
    rest_ns: float
    drift: float

    def machine_ns(self, firmware_ns: int) -> int:
        late = self.rest_ns + self.drift * (firmware_ns - self.origin_ns)
        return firmware_ns + self.offset_ns + round(late)


class FirmwareClock:
    """The estimated mapping from the firmware's clock to this machine's monotonic one."""

    def __init__(self) -> None:
        self._exchanges: deque[ClockExchange] = deque()
        self._line: _Line | None = None
        self._contradictions = 0
        self.jumps = 0
        self.round_trip_us = 0.0
        """The shortest round trip in the window; 0 if there was none. Any thread may read it."""

    def restart(self) -> None:
        """The firmware restarted: its clock starts anew."""
        self._exchanges.clear()
        self._line = None
        self._contradictions = 0
        self.round_trip_us = 0.0

    def add(self, exchange: ClockExchange) -> None:
        """Take one more exchange into account."""
        if self._is_contradicted_by(exchange):
            self._contradictions += 1
            if self._contradictions < CONTRADICTIONS:
                return
            self.jumps += 1
            self.restart()
        self._contradictions = 0
        self._exchanges.append(exchange)
        while self._exchanges[0].received_ns < exchange.received_ns - WINDOW_NS:
            self._exchanges.popleft()
        self.round_trip_us = min(map(_round_trip_ns, self._exchanges)) / 1e3
        needed = NEEDED if self.round_trip_us * 1e3 <= QUICK_NS else NEEDED_SLOW
        if self._line is not None or len(self._exchanges) >= needed:
            self._line = self._fitted()

    @property
    def is_known(self) -> bool:
        """Whether there have been enough exchanges."""
        return self._line is not None

    def machine_ns(self, firmware_ns: int) -> int | None:
        """This machine's monotonic clock when the firmware's read `firmware_ns`, or None."""
        return None if self._line is None else self._line.machine_ns(firmware_ns)

    @property
    def drift_ppm(self) -> float:
        """How much slower the firmware's clock runs than ours, parts per million; 0 if unknown."""
        return 0.0 if self._line is None else self._line.drift * 1e6

    def _is_contradicted_by(self, exchange: ClockExchange) -> bool:
        """Whether the current estimate lies outside the exchange's bounds."""
        if self._line is None:
            return False
        expected_ns = self._line.machine_ns(exchange.firmware_ns)
        early_ns = exchange.sent_ns - expected_ns
        return max(early_ns, expected_ns - exchange.received_ns) > CONTRADICTION_NS

    def _fitted(self) -> _Line:
        """Weighted least squares of offset and drift, with a prior on the drift."""
        last = self._exchanges[-1]
        base_ns = _middle_ns(last) - last.firmware_ns
        at = np.array([float(e.firmware_ns - last.firmware_ns) for e in self._exchanges])
        offset = np.array([_middle_ns(e) - e.firmware_ns - base_ns for e in self._exchanges], float)
        round_trip = np.array([float(_round_trip_ns(e)) for e in self._exchanges])
        sigma = FLOOR_NS + (round_trip - round_trip.min()) / 2
        design = np.column_stack([np.ones_like(at), at]) / sigma[:, None]
        normal = design.T @ design
        normal[1, 1] += DRIFT_SIGMA**-2
        rest_ns, drift = np.linalg.solve(normal, design.T @ (offset / sigma))
        return _Line(last.firmware_ns, base_ns, float(rest_ns), float(drift))


def _middle_ns(exchange: ClockExchange) -> int:
    return (exchange.sent_ns + exchange.received_ns) // 2


def _round_trip_ns(exchange: ClockExchange) -> int:
    return exchange.received_ns - exchange.sent_ns
