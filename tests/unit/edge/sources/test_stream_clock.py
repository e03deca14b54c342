"""When pictures of a stream were taken, by their presentation times, arrivals and RTCP."""

import numpy as np
import pytest
from msgspec.structs import replace

from trigpoint.base.clock import to_ns
from trigpoint.edge.sources.frames import Stamp
from trigpoint.edge.sources.stream_clock import Arrival, StreamClock

UNIX_NS = to_ns(1e9)
PERIOD_NS = to_ns(0.1)


def arrivals(
    delays_s: list[float], *, sender_s: float | None = None, start: int = 0
) -> list[Arrival]:
    """Pictures taken every tenth of a second that come so much later; `sender_s`: what the sender's
    clock is off."""
    found = []
    for number, delay_s in enumerate(delays_s, start):
        taken_ns = number * PERIOD_NS
        sender_ns = None if sender_s is None else UNIX_NS + taken_ns + to_ns(sender_s)
        found.append(Arrival(taken_ns + 777, taken_ns + to_ns(delay_s), UNIX_NS, sender_ns))
    return found


def errors_s(clock: StreamClock, came: list[Arrival]) -> list[tuple[float, Stamp] | None]:
    found = []
    for arrival in came:
        stamp = clock.stamp(arrival)
        true_ns = arrival.presented_ns - 777 + UNIX_NS
        found.append(None if stamp is None else ((stamp[0] - true_ns) / 1e9, stamp[1]))
    return found


def test_arrival_that_jitters_makes_stamps_that_do_not() -> None:
    delays = (0.05 + np.random.default_rng(1).exponential(0.05, 200)).tolist()
    found = errors_s(StreamClock(), arrivals(delays))[20:]
    errors = [error for error, _ in filter(None, found)]
    assert len(errors) == 180
    assert np.ptp(errors) < 0.01
    assert min(errors) == pytest.approx(0.05, abs=0.01)


def test_what_was_kept_before_the_opening_is_left_out() -> None:
    # Two seconds of the past come at once; then pictures come as they are taken.
    backlog = [2.0 - number / 10 + number / 1000 for number in range(20)]
    found = errors_s(StreamClock(), arrivals([*backlog, *[0.05] * 20]))
    assert found[:20] == [None] * 20
    errors = [error for error, _ in filter(None, found)]
    assert len(errors) >= 15
    assert max(errors) < 0.06


def test_senders_clock_is_believed_where_it_can_be_true() -> None:
    found = errors_s(StreamClock(), arrivals([0.2] * 20, sender_s=0.0))[-1]
    assert found == (pytest.approx(0.0, abs=1e-6), Stamp.SENDER)


@pytest.mark.parametrize("sender_s", [-3600.0, 5.0, -1.5, 0.3])
def test_senders_clock_that_is_not_set_is_not_believed(sender_s: float) -> None:
    found = errors_s(StreamClock(), arrivals([0.2] * 20, sender_s=sender_s))[-1]
    assert found == (pytest.approx(0.2, abs=1e-6), Stamp.ARRIVAL)


def test_way_that_is_known_holds_until_the_sender_tells_its_time_again() -> None:
    before = StreamClock()
    errors_s(before, arrivals([0.2] * 20, sender_s=0.0))
    found = errors_s(StreamClock(before.way_ns), arrivals([0.2] * 20))[-1]
    assert found == (pytest.approx(0.0, abs=1e-6), Stamp.SENDER)


def test_new_scale_of_presentation_times_begins_anew() -> None:
    clock = StreamClock()
    errors_s(clock, arrivals([0.05] * 20))
    later = [
        Arrival(a.presented_ns - to_ns(1000.0), a.arrived_ns, a.unix_ns)
        for a in arrivals([0.05] * 20, start=20)
    ]
    stamps = [clock.stamp(arrival) for arrival in later]
    assert stamps[0] is None
    last = stamps[-1]
    assert last is not None
    assert last[0] == pytest.approx(UNIX_NS + later[-1].arrived_ns, abs=1e3)


def test_stamps_rise_whatever_the_sender_tells() -> None:
    # The first word of the sender's time puts a picture 0.2 s back; then one is told twice.
    came = [*arrivals([0.2] * 10), *arrivals([0.2] * 10, sender_s=0.0, start=10)]
    clock, stamps = StreamClock(), []
    for arrival in [*came, came[-1]]:
        stamp = clock.stamp(arrival)
        if stamp is not None:
            stamps.append(stamp[0])
    assert len(stamps) >= 14
    assert (np.diff(stamps) > 0).all()


def test_clock_that_was_set_back_is_followed() -> None:
    clock = StreamClock()
    errors_s(clock, arrivals([0.2] * 10))
    set_back = [replace(a, unix_ns=UNIX_NS - to_ns(60)) for a in arrivals([0.2] * 10, start=10)]
    assert all(clock.stamp(arrival) is not None for arrival in set_back)
