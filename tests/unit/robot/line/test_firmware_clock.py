"""The firmware's clock, against simulated delays."""

import sys
import threading
from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from trigpoint.base.clock import to_ns
from trigpoint.robot.line.firmware_clock import FirmwareClock
from trigpoint.robot.line.protocol import ClockExchange

OFFSET_NS = to_ns(123_456.789)


class Simulated:
    """A firmware whose clock runs `drift_ppm` fast, behind ways that take random times."""

    def __init__(self, seed: int, *, drift_ppm: float, spread_s: float) -> None:
        self.random = np.random.default_rng(seed)
        self.drift_ppm, self.spread_s = drift_ppm, spread_s
        self.shift_ns = 0

    def firmware_ns(self, machine_ns: int) -> int:
        return machine_ns + OFFSET_NS + round(machine_ns * self.drift_ppm * 1e-6) + self.shift_ns

    def exchange(self, sent_ns: int) -> ClockExchange:
        ways = 50e-6 + self.random.exponential(self.spread_s, 2)
        there_ns = sent_ns + to_ns(float(ways[0]))
        back_ns = there_ns + to_ns(float(ways[1]))
        return ClockExchange(sent_ns, self.firmware_ns(there_ns), back_ns)


def exchanged(simulated: Simulated, seconds: float, every_s: float = 0.5) -> FirmwareClock:
    clock = FirmwareClock()
    for k in range(int(seconds / every_s)):
        clock.add(simulated.exchange(to_ns(k * every_s)))
    return clock


def error_us(clock: FirmwareClock, simulated: Simulated, machine_ns: int) -> float:
    mapped_ns = clock.machine_ns(simulated.firmware_ns(machine_ns))
    assert mapped_ns is not None
    return (mapped_ns - machine_ns) / 1e3


def test_nothing_is_claimed_before_a_few_exchanges() -> None:
    simulated, clock = Simulated(0, drift_ppm=0, spread_s=1e-4), FirmwareClock()
    for k in range(3):
        clock.add(simulated.exchange(to_ns(0.02 * k)))
        assert clock.machine_ns(0) is None
    clock.add(simulated.exchange(to_ns(0.08)))
    assert clock.is_known


def test_slow_exchanges_are_not_believed_before_there_are_more() -> None:
    simulated, clock = Simulated(0, drift_ppm=0, spread_s=0.0), FirmwareClock()
    for k in range(9):
        at_ns = to_ns(0.1 * k)
        clock.add(ClockExchange(at_ns, simulated.firmware_ns(at_ns), at_ns + to_ns(0.08)))
        assert not clock.is_known
    clock.add(simulated.exchange(to_ns(1.0)))
    assert clock.is_known
    assert abs(error_us(clock, simulated, to_ns(1.0))) < 100


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 1000), st.floats(-100, 100))
def test_time_is_known_to_a_part_of_the_delays_spread(seed: int, drift_ppm: float) -> None:
    simulated = Simulated(seed, drift_ppm=drift_ppm, spread_s=1e-3)
    clock = exchanged(simulated, 60.0)
    assert abs(error_us(clock, simulated, to_ns(60.0))) < 300
    assert abs(clock.drift_ppm + drift_ppm) < 10


def test_delays_of_one_way_alone_err_by_less_than_half_the_round_trip() -> None:
    simulated, clock = Simulated(0, drift_ppm=0, spread_s=0.0), FirmwareClock()
    for k in range(20):
        sent_ns = to_ns(0.1 * k)
        there_ns = sent_ns + to_ns(0.004)
        exchange = ClockExchange(sent_ns, simulated.firmware_ns(there_ns), there_ns)
        clock.add(exchange)
    assert abs(error_us(clock, simulated, to_ns(2.0))) <= 2001


def test_single_late_answer_moves_time_by_little() -> None:
    simulated = Simulated(1, drift_ppm=5, spread_s=2e-5)
    clock = exchanged(simulated, 20.0)
    before = error_us(clock, simulated, to_ns(20.0))
    sent_ns = to_ns(20.0)
    late = ClockExchange(sent_ns, simulated.firmware_ns(sent_ns + 50_000), sent_ns + to_ns(0.2))
    clock.add(late)
    assert abs(error_us(clock, simulated, to_ns(20.0)) - before) < 5


def test_old_exchanges_leave_so_that_a_changing_drift_is_followed() -> None:
    simulated, clock = Simulated(2, drift_ppm=0, spread_s=2e-5), FirmwareClock()
    for k in range(600):
        if k > 240:
            simulated.shift_ns += to_ns(0.5 * 30e-6)  # 30 ppm faster from then on
        clock.add(simulated.exchange(to_ns(0.5 * k)))
    assert abs(error_us(clock, simulated, to_ns(299.5))) < 50
    assert clock.jumps == 0


def test_clock_that_jumps_without_a_restart_is_followed_after_a_few_exchanges() -> None:
    simulated = Simulated(3, drift_ppm=0, spread_s=2e-5)
    clock = exchanged(simulated, 20.0)
    simulated.shift_ns = to_ns(5.0)
    for k in range(8):
        clock.add(simulated.exchange(to_ns(20.0 + 0.5 * k)))
    assert clock.jumps == 1
    assert abs(error_us(clock, simulated, to_ns(24.0))) < 200


def test_restart_forgets_the_clock() -> None:
    clock = exchanged(Simulated(4, drift_ppm=0, spread_s=2e-5), 5.0)
    clock.restart()
    assert clock.machine_ns(0) is None


def test_stamps_of_a_steady_stream_rise_while_the_estimate_settles() -> None:
    simulated, clock = Simulated(5, drift_ppm=40, spread_s=1e-3), FirmwareClock()
    stamps = []
    for k in range(500):
        machine_ns = to_ns(0.02 * k)
        if k % 5 == 0:
            clock.add(simulated.exchange(machine_ns))
        mapped = clock.machine_ns(simulated.firmware_ns(machine_ns))
        stamps += [] if mapped is None else [mapped]
    assert len(stamps) > 400
    assert all(later > earlier for earlier, later in pairwise(stamps))


def test_diagnostics_may_look_while_an_exchange_comes() -> None:
    simulated, clock = Simulated(0, drift_ppm=0, spread_s=1e-4), FirmwareClock()
    stopping, interval_s = threading.Event(), sys.getswitchinterval()

    def look() -> None:
        while not stopping.is_set():
            assert clock.round_trip_us >= 0

    looker = threading.Thread(target=look)
    sys.setswitchinterval(1e-6)
    looker.start()
    try:
        for k in range(2000):
            clock.add(simulated.exchange(to_ns(0.5 * k)))
        assert looker.is_alive()
    finally:
        stopping.set()
        looker.join()
        sys.setswitchinterval(interval_s)
