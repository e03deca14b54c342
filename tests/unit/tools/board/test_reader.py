"""From the bus to what the pages show, by a clock that is moved by hand."""

import threading
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from msgspec.structs import replace
from support.builders import make_site

from trigpoint.base.clock import ManualClock
from trigpoint.bus.bus import Latest, Sample
from trigpoint.contract import cdr, topics
from trigpoint.contract.cdr import encode
from trigpoint.contract.messages import (
    Diagnostics,
    DiagnosticStatus,
    Message,
    OccupancyGrid,
    Polygon,
    PoseEstimate,
    PoseStamped,
)
from trigpoint.contract.topics import Topic
from trigpoint.geometry import Pose
from trigpoint.metrics.families import families
from trigpoint.site.config import Site
from trigpoint.testing.memory_bus import MemoryBroker, MemoryBus
from trigpoint.tools.board.entities import Entities
from trigpoint.tools.board.feed import Feed
from trigpoint.tools.board.history import History
from trigpoint.tools.board.pictures import Pictures
from trigpoint.tools.board.reader import Reader
from trigpoint.tools.board.scene import Scene

SITE = make_site(cameras=1, robots=3)
_TURNS = 50


class Steps(ManualClock):
    """Has something done in each of these turns, and stops whoever waits after the last."""

    def __init__(self, turns: dict[int, Callable[[], None]], last: int = _TURNS) -> None:
        super().__init__(10**18)
        self._do, self._last, self._turns = turns, last, 0

    def wait(self, event: threading.Event, timeout_s: float) -> bool:
        self._turns += 1
        if self._turns in self._do:
            self._do[self._turns]()
        if self._turns == self._last:
            event.set()
        return super().wait(event, timeout_s)


def shown(say: Callable[[MemoryBus], None]) -> tuple[Entities, Reader]:
    """What the pages show after two and a half seconds in which this was said."""
    broker, feed = MemoryBroker(), Feed()
    with broker.session() as bus, broker.session() as speaking:
        clock = broker.clock = Steps({1: lambda: say(speaking)})
        reader = reader_of(bus, clock, feed)
        reader.run(bus, threading.Event())
    return feed.whole(), reader


def reader_of(bus: MemoryBus, clock: ManualClock, feed: Feed, site: Site = SITE) -> Reader:
    pictures = Pictures(lambda: bus, site.name, frozenset(site.cameras))
    return Reader(site, feed, History(), pictures, about={}, clock=clock)


def put(
    bus: MemoryBus, robot: str, x: float, *, frame: str = "map", variance: float = 1e-4
) -> None:
    covariance = np.diag([variance, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4])
    estimate = PoseEstimate(1, frame, Pose.planar(x, 2.0, 0.5), covariance)
    bus.publisher(topics.ROBOT_POSE, topics.ROBOT_POSE.key(SITE.name, robot)).put(encode(estimate))


def test_of_each_robot_the_newest_pose_is_shown() -> None:
    def say(bus: MemoryBus) -> None:
        for x in (1.0, 2.0, 3.0):
            put(bus, "r1", x)
            put(bus, "r2", -x)

    entities, _ = shown(say)
    assert entities["robot/r1"]["at"] == [3.0, 2.0, 0.5]
    assert entities["robot/r2"]["at"] == [-3.0, 2.0, 0.5]
    assert "at" not in entities["robot/r3"]


def test_since_when_it_is_listened_is_said_for_ever() -> None:
    entities, _ = shown(lambda _bus: None)
    assert entities["site"]["started"] == 10**9


def test_a_pose_that_is_not_sound_and_a_stranger_hide_no_other_and_are_counted() -> None:
    def say(bus: MemoryBus) -> None:
        put(bus, "r1", 1.0)
        put(bus, "stranger", 1.0)
        put(bus, "r3", np.nan)
        put(bus, "r2", 2.0)

    entities, reader = shown(say)
    assert entities["robot/r1"]["at"] == [1.0, 2.0, 0.5]
    assert entities["robot/r2"]["at"] == [2.0, 2.0, 0.5]
    assert "at" not in entities["robot/r3"]
    assert "robot/stranger" not in entities
    assert reader.health.total("rejected") == 2


@pytest.mark.parametrize(
    ("x", "variance", "frame"),
    [
        pytest.param(1.0, 1e-4, "r1/odom", id="not given in the map"),
        (1e308, 1e-4, "map"),
        (-1e7, 1e-4, "map"),
        (1.0, 1e308, "map"),
        (1.0, 1e13, "map"),
        (1.0, -1e-4, "map"),
    ],
)
@pytest.mark.parametrize("others", [[], ["r2"]])
@pytest.mark.filterwarnings("error")
def test_a_pose_elsewhere_or_absurd_is_rejected_and_hides_no_other(
    x: float, variance: float, frame: str, others: list[str]
) -> None:
    def say(bus: MemoryBus) -> None:
        put(bus, "r1", x, variance=variance, frame=frame)
        for robot in others:
            put(bus, robot, 2.0)

    entities, reader = shown(say)
    assert "at" not in entities["robot/r1"]
    assert all(entities[f"robot/{robot}"]["at"] == [2.0, 2.0, 0.5] for robot in others)
    assert reader.health.total("rejected") == 1


@pytest.mark.filterwarnings("error")
def test_absurd_goals_outlines_and_grids_are_rejected() -> None:
    far, cell = Pose.planar(1e308, 0.0, 0.0), np.zeros((1, 1), np.int8)

    def say(bus: MemoryBus) -> None:
        for topic, name, message in (
            (topics.SUGGESTION, "r1", PoseStamped(1, "map", far)),
            (topics.COVERAGE, "c1", Polygon(1, "map", np.full((3, 3), -1e7))),
            (topics.COVERAGE_GRID, "", OccupancyGrid(1, "map", 0.1, far, cell)),
        ):
            bus.publisher(topic, topic.key(SITE.name, name)).put(encode(message))

    entities, reader = shown(say)
    assert "goal" not in entities["robot/r1"]
    assert "floor" not in entities["camera/c1"]
    assert "grid" not in entities
    assert reader.health.total("rejected") == 3


def test_an_outline_that_is_not_given_in_the_map_is_rejected() -> None:
    def say(bus: MemoryBus) -> None:
        outline = encode(Polygon(1, "c1/optical", np.eye(3)))
        bus.publisher(topics.COVERAGE, topics.COVERAGE.key(SITE.name, "c1")).put(outline)

    entities, reader = shown(say)
    assert "floor" not in entities["camera/c1"]
    assert reader.health.total("rejected") == 1


def test_strangers_and_unsound_poses_do_not_have_the_others_taken_one_by_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    taken: list[list[str]] = []
    decoded: list[str] = []
    monkeypatch.setattr(Scene, "take_poses", lambda _self, names, *_: taken.append(names))
    decode = cdr.decode

    def count(name: str, payload: bytes) -> Message:
        decoded.append(name)
        return decode(name, payload)

    monkeypatch.setattr(cdr, "decode", count)

    def say(bus: MemoryBus, *, x: float = 1.0) -> None:
        put(bus, "stranger", 1.0)
        put(bus, "r1", 1.0)
        put(bus, "r2", x)
        put(bus, "r3", 3.0)

    shown(say)
    assert taken == [["robot/r1", "robot/r2", "robot/r3"]]
    assert decoded == []
    shown(partial(say, x=np.nan))
    assert taken[1:] == [["robot/r1", "robot/r3"]]


def test_a_report_with_a_level_that_is_none_does_not_end_the_reader() -> None:
    def say(bus: MemoryBus) -> None:
        status = DiagnosticStatus(3, "edge/c9", "", "", {})
        report = encode(Diagnostics(1, (status,))).replace(b"\x03", b"\xc8")
        bus.publisher(topics.DIAGNOSTICS, topics.DIAGNOSTICS.key(SITE.name)).put(report)
        put(bus, "r1", 1.0)

    entities, reader = shown(say)
    assert entities["robot/r1"]["at"] == [1.0, 2.0, 0.5]
    assert reader.health.total("rejected") == 1


def test_many_reports_at_once_do_not_hold_up_what_moves(monkeypatch: pytest.MonkeyPatch) -> None:
    """They are all heard within two seconds, and between two looks at what moves only a part."""
    heard, most, count = [0], [0], 200
    hear, read = Reader._hear, Reader._read

    def counted(reader: Reader, sample: Sample) -> None:
        heard[0] += 1
        hear(reader, sample)

    def between(reader: Reader, latest: list[tuple[Topic, Latest]]) -> None:
        most.append(heard[0])
        read(reader, latest)

    monkeypatch.setattr(Reader, "_hear", counted)
    monkeypatch.setattr(Reader, "_read", between)

    def say(bus: MemoryBus) -> None:
        publisher = bus.publisher(topics.DIAGNOSTICS, topics.DIAGNOSTICS.key(SITE.name))
        for number in range(count):
            status = DiagnosticStatus(0, f"edge/c{number}", "", "", {})
            publisher.put(encode(Diagnostics(1, (status,))))

    shown(say)
    assert heard[0] == count
    assert max(np.diff(most)) <= count / 4


def test_whom_fusion_corrects_is_known_by_its_report() -> None:
    def say(bus: MemoryBus) -> None:
        counter = f"sent {topics.CORRECTION.key(SITE.name, 'r2')}"
        values = {f"{counter}.total": "10", f"{counter}.rate": "10.0"}
        status = DiagnosticStatus(0, "fusion/fusion", "running", "lab", values)
        report = encode(Diagnostics(1, (status,)))
        bus.publisher(topics.DIAGNOSTICS, topics.DIAGNOSTICS.key(SITE.name)).put(report)

    entities, _ = shown(say)
    assert entities["robot/r2"]["fixed"] == 10**9
    assert "fixed" not in entities["robot/r1"]


def test_metrics_have_one_level_of_a_node_also_where_it_comes_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Prometheus takes no page with two values of one series."""
    unreached: list[str] = []
    monkeypatch.setattr(MemoryBus, "unreached", property(lambda _: tuple(unreached)))
    site = replace(SITE, expect=("fusion", "recorder"))
    pages: list[tuple[list[tuple[str, float]], list[str]]] = []

    def look() -> None:
        found = families(site.name, reader.heard())
        level, reported = (
            [(sample.labels["node"], sample.value) for sample in family.samples]
            for family in found
            if family.name in ("trigpoint_node_level", "trigpoint_report_timestamp_seconds")
        )
        pages.append((sorted(level), sorted(node for node, _ in reported)))

    def speak(node: str, level: int) -> None:
        status = DiagnosticStatus(level, "edge/c1", "", "pc", {"node": node})
        report = encode(Diagnostics(1, (status,)))
        speaking.publisher(topics.DIAGNOSTICS, topics.DIAGNOSTICS.key(site.name)).put(report)

    turns: dict[int, Callable[[], None]] = {
        65: look,
        66: partial(unreached.append, "tcp/127.0.0.1:9"),
        90: look,
        91: unreached.clear,
        92: partial(speak, "old", 1),
        112: partial(speak, "new", 0),
        134: look,
    }
    broker = MemoryBroker()
    with broker.session() as bus, broker.session() as speaking:
        clock = broker.clock = Steps(turns, 135)
        reader = reader_of(bus, clock, Feed(), site)
        reader.run(bus, threading.Event())
    absent, apart, back = pages
    others = ["fusion/fusion", "recorder/main", "robot/r1", "robot/r2", "robot/r3"]
    missing = [(node, 2.0) for node in ["edge/c1", *others]]
    assert absent == ([("board", 0.0), *missing], ["board"])
    assert apart == ([("board", 0.0)], ["board"])
    assert back == ([("board", 0.0), ("edge/c1", 0.0)], ["board", "edge/c1"])
