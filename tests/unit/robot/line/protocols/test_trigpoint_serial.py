"""Bridge and firmware back to back over a line made of bytes, with a clock that the test moves."""

from uuid import UUID

import numpy as np
import pytest

from trigpoint.base.clock import to_ns
from trigpoint.geometry import Pose
from trigpoint.robot.firmware.endpoint import FirmwareEndpoint
from trigpoint.robot.line.protocol import (
    Acknowledged,
    ClockExchange,
    Connected,
    Damaged,
    Event,
    Mismatched,
    Missing,
    Reading,
    RobotCorrection,
    Setup,
    Silent,
    Unanswered,
    Vitals,
)
from trigpoint.robot.line.protocols.trigpoint_serial import TIMES_SENT, TrigpointSerial
from trigpoint.site.config import RobotConfig

MAP = UUID(int=1)
FIRMWARE_AHEAD_NS = to_ns(1000.0)
STEP_NS = to_ns(0.005)


class Conversation:
    """Both ends and the wire; `way_ns`: how long bytes take one way."""

    def __init__(self, *, version: int = 1, name: str = "r1", way_ns: int = 0) -> None:
        self.now_ns, self.way_ns = to_ns(1.0), way_ns
        self.version, self.name, self.boot = version, name, 100
        self.bridge = TrigpointSerial(Setup("r1", RobotConfig(port="x"), 77))
        self.events: list[Event] = []
        self.to_robot: list[tuple[int, bytes]] = []
        self.to_bridge: list[tuple[int, bytes]] = []
        self.deaf_robot = self.deaf_bridge = False
        self.sent_by_bridge = b""
        self.start_firmware()

    def start_firmware(self) -> None:
        self.boot += 1
        self.robot = FirmwareEndpoint(
            name=self.name, program="test", boot=self.boot, version=self.version
        )
        self.from_robot(self.robot.hello())

    def from_robot(self, data: bytes) -> None:
        if not self.deaf_bridge and data:
            self.to_bridge.append((self.now_ns + self.way_ns, data))

    def step(self) -> None:
        self.now_ns += STEP_NS
        self.events += self.bridge.elapse(self.now_ns)
        if self.bridge.due_ns(self.now_ns) <= self.now_ns:
            data = self.bridge.data_to_send(self.now_ns)
            self.sent_by_bridge += data
            if not self.deaf_robot:
                self.to_robot.append((self.now_ns + self.way_ns, data))
        for data in self._arrived(self.to_robot):
            self.from_robot(self.robot.receive(data, self.now_ns + FIRMWARE_AHEAD_NS))
        self.from_robot(self.robot.heartbeat(self.now_ns + FIRMWARE_AHEAD_NS))
        for data in self._arrived(self.to_bridge):
            self.events += self.bridge.receive(data, self.now_ns)

    def _arrived(self, wire: list[tuple[int, bytes]]) -> list[bytes]:
        here = [data for at_ns, data in wire if at_ns <= self.now_ns]
        wire[:] = [(at_ns, data) for at_ns, data in wire if at_ns > self.now_ns]
        return here

    def run(self, seconds: float) -> None:
        for _ in range(round(to_ns(seconds) / STEP_NS)):
            self.step()

    def drive(self, x: float) -> int:
        """One odometry reading; returns its stamp."""
        stamp_ns = self.now_ns + FIRMWARE_AHEAD_NS
        pose = Pose.planar(x, 0.0, 0.0)
        self.from_robot(self.robot.odometry(stamp_ns, pose, np.zeros(3), np.zeros(3)))
        return stamp_ns

    def correct(self, number: int, stamp_ns: int, pose: Pose | None = None) -> None:
        pose = pose or Pose.planar(5.0, 0.0, 0.0)
        covariance = np.eye(6) * 1e-4
        self.bridge.correct(
            RobotCorrection(number, stamp_ns, MAP, number, pose, covariance, establishes=False)
        )

    def of(self, kind: type) -> list[Event]:
        return [event for event in self.events if isinstance(event, kind)]


def test_bridge_learns_who_is_there() -> None:
    line = Conversation()
    line.run(0.1)
    assert line.of(Connected) == [Connected("r1", "test", 101)]
    assert line.of(Damaged) == line.of(Missing) == []


def test_bridge_that_comes_later_asks_who_is_there() -> None:
    line = Conversation()
    line.to_bridge.clear()  # the firmware said hello before anyone listened
    line.run(0.1)
    assert line.of(Connected) == [Connected("r1", "test", 101)]


def test_clock_exchange_holds_the_firmwares_time_between_question_and_answer() -> None:
    line = Conversation(way_ns=to_ns(0.02))
    line.run(2.0)
    exchanges = line.of(ClockExchange)
    assert len(exchanges) > 10
    for exchange in exchanges:
        assert isinstance(exchange, ClockExchange)
        firmware_ns = exchange.firmware_ns - FIRMWARE_AHEAD_NS
        assert exchange.sent_ns + to_ns(0.02) <= firmware_ns <= exchange.received_ns - to_ns(0.02)


def test_odometry_arrives_as_it_was_sent() -> None:
    line = Conversation()
    line.run(0.1)
    stamp_ns = line.drive(1.25)
    line.run(0.1)
    [reading] = line.of(Reading)
    assert isinstance(reading, Reading)
    assert reading.firmware_ns == stamp_ns
    assert reading.pose.translation.tolist() == [1.25, 0, 0]


def test_correction_moves_the_robots_map_and_is_acknowledged() -> None:
    line = Conversation()
    line.run(0.1)
    stamp_ns = line.drive(1.0)
    line.step()
    line.drive(2.0)
    line.correct(1, stamp_ns)  # it was at 5 m when it had counted 1 m
    line.run(0.1)
    [answer] = line.of(Acknowledged)
    assert isinstance(answer, Acknowledged)
    assert (answer.number, answer.is_accepted) == (1, True)
    assert line.robot.map_from_base is not None
    assert line.robot.map_from_base.translation.tolist() == [6.0, 0, 0]


def test_firmware_refuses_a_correction_older_than_its_history_and_says_why() -> None:
    line = Conversation()
    line.run(0.1)
    line.correct(1, line.drive(0.0) - to_ns(60.0))
    line.run(0.1)
    [answer] = line.of(Acknowledged)
    assert isinstance(answer, Acknowledged)
    assert (answer.is_accepted, answer.reason) == (False, "too old")


def test_correction_without_an_answer_is_repeated_then_given_up() -> None:
    line = Conversation()
    line.run(0.1)
    stamp_ns = line.drive(0.0)
    line.deaf_bridge = True
    line.correct(7, stamp_ns)
    line.run(1.0)
    assert line.of(Unanswered) == [Unanswered(7)]
    assert len(line.robot.applied) == 1  # it came three times
    assert TIMES_SENT == 3


def test_newer_correction_replaces_one_that_waits_for_its_answer() -> None:
    line = Conversation()
    line.run(0.1)
    stamp_ns = line.drive(0.0)
    line.deaf_robot = True
    line.correct(1, stamp_ns)
    line.run(0.05)
    line.correct(2, stamp_ns)
    line.deaf_robot = False
    line.run(1.0)
    assert [correction.number for correction in line.robot.applied] == [2]
    assert line.of(Unanswered) == []


def test_firmware_that_restarts_is_noticed_by_its_hello() -> None:
    line = Conversation()
    line.run(0.5)
    line.start_firmware()
    line.run(0.5)
    assert [event.boot for event in line.of(Connected) if isinstance(event, Connected)] == [
        101,
        102,
    ]
    assert line.of(Missing) == []


def test_firmware_that_restarts_is_noticed_though_its_hello_is_lost() -> None:
    line = Conversation()
    line.run(0.5)
    line.deaf_bridge = True
    line.start_firmware()
    line.deaf_bridge = False
    line.drive(9.0)
    line.run(0.5)
    assert [event.boot for event in line.of(Connected) if isinstance(event, Connected)] == [
        101,
        102,
    ]
    assert line.of(Reading) == []  # it belongs to a clock that is not known yet


def test_lost_frames_are_counted() -> None:
    line = Conversation()
    line.run(0.1)
    line.drive(0.0)
    line.deaf_bridge = True
    for x in range(3):
        line.drive(float(x))
    line.deaf_bridge = False
    line.drive(4.0)
    line.run(0.1)
    assert line.of(Missing) == [Missing(3)]


def test_frames_lost_while_the_port_was_away_are_counted() -> None:
    line = Conversation()
    line.run(0.1)
    line.bridge.reset()
    line.to_bridge.clear()
    line.deaf_bridge = True
    line.drive(1.0)
    line.deaf_bridge = False
    line.run(0.1)
    assert line.of(Missing) == [Missing(1)]
    assert len(line.of(Connected)) == 2


@pytest.mark.parametrize(
    ("version", "remedy"), [(0, "update the firmware"), (2, "update this bridge")]
)
def test_another_version_is_named_and_nothing_is_sent_to_it(version: int, remedy: str) -> None:
    line = Conversation(version=version)
    line.run(0.6)
    text = line.of(Mismatched)[0]
    assert isinstance(text, Mismatched)
    assert f"version {version} of the serial protocol" in text.text
    assert remedy in text.text
    line.correct(1, line.drive(0.0))
    line.run(1.0)
    assert line.of(Reading) == line.of(Connected) == line.robot.applied == []


def test_another_robot_at_the_port_is_named_and_not_used() -> None:
    line = Conversation(name="r2")
    line.run(0.1)
    line.drive(1.0)
    line.run(0.1)
    wrong = line.of(Mismatched)[0]
    assert isinstance(wrong, Mismatched)
    assert "«r2», not «r1»" in wrong.text
    assert line.of(Reading) == []


def test_silence_is_told_once_and_the_bridge_asks_again() -> None:
    line = Conversation()
    line.run(1.0)
    line.deaf_bridge = True
    line.run(6.0)
    assert len(line.of(Silent)) == 1
    line.deaf_bridge = False
    line.run(1.0)
    assert len(line.of(Connected)) == 2


def test_heartbeat_tells_what_the_firmware_rejected() -> None:
    line = Conversation()
    line.run(0.1)
    line.to_robot.append((line.now_ns, b"garbage\0"))
    line.run(2.0)
    vitals = line.of(Vitals)[-1]
    assert isinstance(vitals, Vitals)
    assert vitals.rejected == 1
    assert vitals.received > 10


def test_garbage_is_reported_and_the_conversation_goes_on() -> None:
    line = Conversation()
    line.run(0.1)
    line.from_robot(b"\x05\xff\xff\0" * 3)
    line.drive(1.0)
    line.run(0.1)
    assert len(line.of(Damaged)) == 3
    assert len(line.of(Reading)) == 1


def test_correction_for_a_robot_that_restarts_is_not_sent_to_the_new_clock() -> None:
    line = Conversation()
    line.run(0.5)
    stamp_ns = line.drive(0.0)
    line.deaf_robot = True
    line.correct(1, stamp_ns)
    line.run(0.02)
    line.start_firmware()
    line.run(0.01)
    line.deaf_robot = False
    line.drive(0.0)
    line.run(1.0)
    assert line.robot.applied == []
