"""Why no odometry comes, live and in a dry run."""

import logging
from dataclasses import dataclass
from uuid import uuid4

import numpy as np
import pytest
from support.builders import make_site

from trigpoint.base.clock import ManualClock, to_ns
from trigpoint.bus.bus import Sample
from trigpoint.contract.correction import CorrectionMark
from trigpoint.contract.messages import PoseEstimate
from trigpoint.contract.topics import CORRECTION
from trigpoint.geometry import Pose
from trigpoint.node.clock_watch import CLOCK_IS_OFF
from trigpoint.node.health import Health
from trigpoint.robot.bridge import Bridge
from trigpoint.robot.corrections import Corrections
from trigpoint.robot.line.protocol import Acknowledged, Connected, Damaged, DamageKind, Event
from trigpoint.robot.odometry.stamps import Offset
from trigpoint.robot.quiet import CorrectionWatch, OdometryWatch, why_nothing
from trigpoint.site.config import RobotConfig

KEY = "lab/robot/r1/correction"


@dataclass
class Port:
    """The line, as far as it is looked at."""

    last_line: str = ""
    is_open: bool = True


def bridge(health: Health, *events: Event) -> Bridge:
    made = Bridge("r1", RobotConfig(port="x"), health, Offset(0))
    for event in events:
        made.on_event(event)
    return made


@pytest.mark.parametrize(
    ("line", "events", "words"),
    [
        ("", [], "nothing comes from robot r1"),
        ("Invalid Command", [], "the last that came: «Invalid Command»"),
        ("1 2", [Connected("r1", "test", 1)], "answers but sends no odometry"),
        ("x", [Damaged(DamageKind.CONTENT, "«x» is no count")], "«x» is no count"),
    ],
)
def test_reason_is_what_came(line: str, events: list[Event], words: str) -> None:
    assert words in why_nothing("r1", "create2", Port(line), bridge(Health(), *events))


def test_port_without_odometry_is_said_every_five_seconds() -> None:
    health, port = Health(ManualClock()), Port("Hello")
    watch = OdometryWatch("r1", "create2", port, bridge(health), health)
    said = []
    for second in range(1, 15):
        if second == 8:
            port.last_line = "Bye"
        watch.look(to_ns(float(second)))
        said.append(health.last_error)
    assert said[:5] == [""] * 5
    assert [text.count("«Hello»") + 2 * text.count("«Bye»") for text in said[5:]] == (
        [1] * 5 + [2] * 4
    )
    health.count("odometry")
    watch.look(to_ns(15.0))
    port.is_open = False
    health.fail("")
    watch.look(to_ns(30.0))
    assert health.last_error == ""


@dataclass
class Listener:
    """A node that heard fusion so long ago."""

    health: Health
    fusion_away_s: float | None = None
    trouble: str = ""

    def silent_s(self, server: str) -> float | None:
        assert server == "fusion"
        return self.fusion_away_s

    def trouble_of(self, server: str) -> str:
        assert server == "fusion"
        return self.trouble


def test_missing_corrections_are_an_error_only_where_fusion_went_away() -> None:
    health = Health(ManualClock())
    node = Listener(health, 0.5)
    watch = CorrectionWatch("r1", bridge(health), node, KEY)
    watch.look(to_ns(1.0))
    health.count("corrections_accepted")
    watch.look(to_ns(2.0))
    watch.look(to_ns(11.0))
    assert (health.held, words(health)) == ({}, "")
    watch.look(to_ns(14.0))
    assert health.held == {}
    assert "no corrections for 12 s: no located camera sees" in words(health)
    node.fusion_away_s = 6.0
    watch.look(to_ns(15.0))
    assert "no corrections for 13 s: fusion is not running" in health.held["corrections"]
    health.count("corrections_accepted")
    watch.look(to_ns(16.0))
    assert (health.held, words(health)) == ({}, "")


def test_what_keeps_corrections_from_a_robot_is_what_is_told() -> None:
    health = Health(ManualClock())
    node, made = Listener(health, 0.5), bridge(health)
    watch = CorrectionWatch("r1", made, node, KEY)
    watch.look(to_ns(1.0))
    watch.look(to_ns(12.0))
    assert "no corrections for 11 s: no located camera sees it; robot r1 goes on" in words(health)
    health.count(f"received {KEY}")  # they come, and none is taken: why, the bridge itself knows
    watch.look(to_ns(13.0))
    assert "for 12 s: the first is being judged" in words(health)
    health.count(f"received {KEY}")
    at = PoseEstimate(10**18, "map", Pose.planar(1.0, 2.0, 0.5), np.eye(6))
    made.on_correction(at, CorrectionMark(uuid4(), 1), 0)
    watch.look(to_ns(14.0))
    assert "for 13 s: the robot is not connected;" in words(health)
    health.hold(CLOCK_IS_OFF, "this machine's clock is 2.000 s ahead of fusion's")
    health.count(f"received {KEY}")
    watch.look(to_ns(15.0))
    assert "for 14 s: this machine's clock is 2.000 s ahead" in words(health)


OF_OTHERS = "camera «c9» is not in the site file; no odometry of r10 for 7 s; check its bridge"
LATE = "sightings of c2 come over 1 s late and make no corrections"
HUNG = "no sign of life of: fusion/fusion solves"


@pytest.mark.parametrize(
    ("trouble", "said"),
    [
        (OF_OTHERS, ""),
        (f"{LATE}; synchronise the clocks; {OF_OTHERS}", f"; fusion says: {LATE}"),
        (f"{OF_OTHERS}; no odometry of r1 for 9 s", "; fusion says: no odometry of r1 for 9 s"),
        (f"{HUNG}; {OF_OTHERS}", f"; fusion says: {HUNG}"),
        ("no corrections " * 50, f"; fusion says: {'no corrections ' * 13}no …"),
    ],
)
def test_of_fusions_trouble_what_may_be_why_is_added(trouble: str, said: str) -> None:
    health = Health(ManualClock())
    watch = CorrectionWatch("r1", bridge(health), Listener(health, 0.5, trouble), KEY)
    watch.look(to_ns(1.0))
    watch.look(to_ns(12.0))
    why = words(health).removeprefix("no corrections for 11 s: ")
    assert why.partition("; robot r1 goes on")[0] == f"no located camera sees it{said}"


def test_each_kind_of_reason_is_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    health = Health(ManualClock())
    node = Listener(health, 0.5)
    watch = CorrectionWatch("r1", bridge(health), node, KEY)
    watch.look(to_ns(1.0))
    with caplog.at_level(logging.INFO):
        for second in range(12, 20):
            node.trouble = f"no corrections by {'ab'[second % 2]}"
            watch.look(to_ns(float(second)))
        health.count(f"received {KEY}")
        watch.look(to_ns(20.0))
    assert ["located" in text for text in caplog.messages] == [True, False]


def test_refusal_is_that_of_the_last_correction_whoever_refused_it() -> None:
    health = Health(ManualClock())
    made = bridge(health)
    at = PoseEstimate(10**18, "map", Pose.planar(1.0, 2.0, 0.5), np.eye(6))
    made.on_correction(at, CorrectionMark(uuid4(), 1), 0)
    assert made.refusal == "the robot is not connected"
    corrections = Corrections(make_site(), made, health, ManualClock(), lambda _: None)
    corrections.take(Sample(KEY, b"garbage", CORRECTION.encoding, 0, 0))
    watch = CorrectionWatch("r1", made, Listener(health, 0.5), KEY)
    watch.look(to_ns(1.0))
    health.count(f"received {KEY}")
    watch.look(to_ns(12.0))
    assert "no corrections for 11 s: the last was rejected: " in words(health)
    made.on_event(Acknowledged(1, False, "too old", 10**6))
    watch.look(to_ns(13.0))
    assert "for 12 s: robot r1 refused a correction: too old;" in words(health)


def words(health: Health) -> str:
    return health.report().values["uncorrected"]
