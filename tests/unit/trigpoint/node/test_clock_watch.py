"""A clock that is off by more than is borne is told, which way and what for, and only then."""

import json
from collections.abc import Iterator
from contextlib import closing

import pytest
from support.builders import make_site

from trigpoint.base.clock import ManualClock, to_ns, to_seconds
from trigpoint.contract.clock_doubt import CLOCK_OFF_BY
from trigpoint.node.clock_watch import ClockOffset, ClockWatch
from trigpoint.node.node import Node
from trigpoint.testing.memory_bus import MemoryBroker

NOW_NS = 1_800_000_000_000_000_000
LIMIT_S = 0.006


@pytest.mark.parametrize(
    ("offset_s", "uncertainty_s", "is_off"),
    [
        (0.005, 0.0, False),
        (0.007, 0.0005, True),
        (-0.007, 0.0005, True),
        (0.007, 0.002, False),
        (3.0, 0.5, True),
    ],
)
def test_only_what_is_certain_holds(offset_s: float, uncertainty_s: float, is_off: bool) -> None:
    assert ClockOffset(offset_s, uncertainty_s).exceeds(LIMIT_S) == is_off


class Desk:
    """A bridge's machine whose clock the test sets, and fusion, whose answers take time, and during
    the next of which the machine's clock is set by `step_ns`."""

    def __init__(self, broker: MemoryBroker) -> None:
        self.bus, self.fusion = broker.session(), broker.session()
        self.clock = ManualClock(NOW_NS)
        self.set_ns = self.ahead_ns = self.way_ns = self.step_ns = 0
        self.node = Node(self.bus, site="lab", kind="robot", name="r1", clock=self.clock)
        self.watch = ClockWatch(
            self.bus,
            self.node,
            make_site(),
            lambda: self.clock.now_ns() + self.set_ns,
            LIMIT_S,
            "corrections are held",
        )
        self.served = self.fusion.serve("lab/clock", self._answer)

    @property
    def shown(self) -> str | None:
        """The offset in the diagnostics, ms."""
        return self.node.health.report().values.get("clock_offset_ms")

    def _answer(self, _: bytes) -> bytes:
        self.clock.advance(to_seconds(self.way_ns))
        said = json.dumps({"now_ns": self.clock.now_ns() + self.ahead_ns}).encode()
        self.clock.advance(to_seconds(self.way_ns))
        self.set_ns, self.step_ns = self.set_ns + self.step_ns, 0
        return said


@pytest.fixture
def desk() -> Iterator[Desk]:
    desk = Desk(MemoryBroker())
    with closing(desk.bus), closing(desk.fusion):
        yield desk


def test_clock_that_is_off_holds_until_it_is_set_right(desk: Desk) -> None:
    desk.watch.ask()
    assert not desk.watch.is_off
    desk.ahead_ns = 20_000_000
    for _ in range(8):
        desk.watch.ask()
    assert desk.watch.is_off
    assert list(desk.node.health.held.values()) == [
        "this machine's clock is 0.020 s behind fusion's, where 0.006 s are borne: corrections are "
        "held; synchronise the clocks (trigpoint doctor)"
    ]
    assert desk.node.health.report().values[CLOCK_OFF_BY] == "-0.02"
    desk.ahead_ns = -1_000_000
    for _ in range(8):
        desk.watch.ask()
    assert not desk.watch.is_off
    assert CLOCK_OFF_BY not in desk.node.health.report().values
    assert desk.node.health.held == {}
    desk.ahead_ns = -2_000_000_000
    for _ in range(8):
        desk.watch.ask()
    assert "is 2.000 s ahead of fusion's" in desk.node.health.last_error


def test_slow_answer_does_not_hold_but_a_quick_one_tells(desk: Desk) -> None:
    desk.ahead_ns, desk.way_ns = 20_000_000, 50_000_000
    desk.watch.ask()
    assert not desk.watch.is_off
    desk.way_ns = 1_000_000
    desk.watch.ask()
    assert desk.watch.is_off


@pytest.mark.parametrize("step_s", [-2.0, 2.0])
@pytest.mark.parametrize("is_during", [True, False])
def test_clock_that_is_set_forgets_what_was_learnt_before(
    desk: Desk, step_s: float, is_during: bool
) -> None:
    desk.ahead_ns = to_ns(step_s)  # wrong by this much until it is set
    desk.way_ns = 1_000_000
    desk.watch.ask()
    assert desk.watch.is_off
    desk.way_ns = 2_000_000  # what comes after is less certain, and counts all the same
    if is_during:
        desk.step_ns = desk.ahead_ns
        desk.watch.ask()
        assert (desk.shown, desk.watch.is_off) == (None, False)
    else:
        desk.set_ns = desk.ahead_ns
    for _ in range(2):
        desk.watch.ask()
        assert (desk.shown, desk.watch.is_off) == ("0", False)
    assert desk.node.health.held == {}


def test_what_fusion_said_is_forgotten_when_it_no_longer_answers(desk: Desk) -> None:
    assert desk.shown is None
    desk.ahead_ns = 20_000_000
    desk.watch.ask()
    assert (desk.shown, desk.watch.is_off) == ("20", True)
    desk.served.close()
    for _ in range(7):
        desk.watch.ask()
        assert desk.watch.is_off
    desk.watch.ask()
    assert (desk.shown, desk.watch.is_off, desk.node.health.held) == (None, False, {})


def test_nobody_who_answers_and_garbage_hold_nothing(desk: Desk) -> None:
    desk.served.close()
    desk.watch.ask()
    for said in (b"", b"[]", b'{"now_ns": "noon"}', b'{"now": 1}'):
        with closing(desk.fusion.serve("lab/clock", lambda _, said=said: said)):
            desk.watch.ask()
    assert not desk.watch.is_off
