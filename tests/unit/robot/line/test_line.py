"""A port with a protocol on it: lost and opened again, on threads."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from uuid import UUID

import numpy as np
import pytest

from trigpoint.base.clock import SystemClock
from trigpoint.base.errors import PortError
from trigpoint.geometry import Pose
from trigpoint.robot.firmware.endpoint import FirmwareEndpoint
from trigpoint.robot.line.line import Line
from trigpoint.robot.line.protocol import Connected, Event, RobotCorrection, Setup
from trigpoint.robot.line.protocols.ros_arduino_bridge import RosArduinoBridge
from trigpoint.robot.line.protocols.trigpoint_serial import TrigpointSerial
from trigpoint.site.config import RobotConfig, WheelConfig


class FakePort:
    """A port whose other end is a firmware, until it is unplugged."""

    def __init__(self, robot: FirmwareEndpoint) -> None:
        self._robot = robot
        self._ready = threading.Condition()
        self._bytes = b""
        self._is_unplugged = False
        self.is_closed = False

    def read(self) -> tuple[bytes, int]:
        with self._ready:
            self._ready.wait_for(lambda: self._bytes or self._is_unplugged, 0.05)
            if self._is_unplugged:
                raise PortError("Port x was lost.")
            data, self._bytes = self._bytes, b""
            return data, time.monotonic_ns()

    def write(self, data: bytes) -> None:
        with self._ready:
            self._bytes += self._robot.receive(data, time.monotonic_ns())
            self._ready.notify()

    def unplug(self) -> None:
        with self._ready:
            self._is_unplugged = True
            self._ready.notify()

    def close(self) -> None:
        self.is_closed = True


class Desk:
    """What the line sees: ports that open, or not."""

    def __init__(self) -> None:
        self.robot = FirmwareEndpoint(name="r1", program="test", boot=1)
        self.ports: list[FakePort] = []
        self.failing = 0
        self.events: list[Event] = []
        self.troubles: list[str] = []

    def open(self) -> FakePort:
        if self.failing:
            self.failing -= 1
            raise PortError("Port x does not exist.")
        self.ports.append(FakePort(self.robot))
        return self.ports[-1]

    def line(self, patience_s: float = 5.0) -> Line:
        return Line(
            self.open,
            TrigpointSerial(Setup("r1", RobotConfig(port="x"), 77)),
            clock=SystemClock(),
            handle=self.events.append,
            failed=self.troubles.append,
            patience_s=patience_s,
        )

    @property
    def connections(self) -> int:
        return sum(isinstance(event, Connected) for event in self.events)


@contextmanager
def running(line: Line) -> Iterator[None]:
    stopping = threading.Event()
    runs = (line.read_until, line.write_until)
    threads = [threading.Thread(target=run, args=(stopping,)) for run in runs]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        stopping.set()
        for thread in threads:
            thread.join(5.0)
        assert not any(thread.is_alive() for thread in threads)


def until(condition: Callable[[], bool], seconds: float = 10.0) -> bool:
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)
    return condition()


def test_line_talks_to_the_robot_and_closes_its_port() -> None:
    desk = Desk()
    with running(desk.line()):
        assert until(lambda: desk.connections == 1)
    assert [port.is_closed for port in desk.ports] == [True]
    assert desk.troubles == []


def test_correction_is_at_the_robot_when_whoever_brings_it_goes_on() -> None:
    desk = Desk()
    line = desk.line()
    desk.robot.odometry(5, Pose.identity(), np.zeros(3), np.zeros(3))
    with running(line):
        assert until(lambda: desk.connections == 1)
        line.correct(RobotCorrection(1, 5, UUID(int=7), 9, Pose.identity(), np.eye(6), True))
        assert [applied.sequence for applied in desk.robot.applied] == [9]


def test_unplugged_port_is_opened_again_and_the_robot_asked_anew() -> None:
    desk = Desk()
    line = desk.line()
    with running(line):
        assert until(lambda: desk.connections == 1)
        desk.failing = 2
        desk.ports[0].unplug()
        assert until(lambda: desk.connections == 2)
    assert line.opened == 2
    assert [port.is_closed for port in desk.ports] == [True, True]
    assert desk.troubles == ["Port x was lost."] + ["Port x does not exist."] * 2


def test_port_that_comes_soon_is_waited_for() -> None:
    desk = Desk()
    desk.failing = 2
    with running(desk.line()):
        assert until(lambda: desk.connections == 1)


def test_port_that_never_opens_ends_the_line_with_its_reason() -> None:
    desk = Desk()
    desk.failing = 10**9
    with pytest.raises(PortError, match="does not exist"):
        desk.line(patience_s=0.0).read_until(threading.Event())


class QuickBoard(FakePort):
    """ros_arduino_bridge's sketch: answers at once, and counts the questions."""

    def __init__(self) -> None:
        super().__init__(FirmwareEndpoint(name="", program="", boot=1))
        self.questions = 0

    def write(self, data: bytes) -> None:
        with self._ready:
            self.questions += data.count(b"e")
            self._bytes += b"7 7\r\n" * data.count(b"e")
            self._ready.notify()


def test_board_that_answers_at_once_is_asked_at_its_rate() -> None:
    """Its answer makes the next question due earlier than the writer meant to look."""
    board, events = QuickBoard(), list[Event]()
    wheels = WheelConfig(0.1, 0.3, 1000)
    config = RobotConfig(port="x", protocol="ros_arduino_bridge", wheels=wheels)
    line = Line(
        lambda: board,
        RosArduinoBridge(Setup("r1", config, 1)),
        clock=SystemClock(),
        handle=events.append,
        failed=pytest.fail,
    )
    started_s = time.monotonic()
    with running(line):
        assert until(lambda: board.questions >= 10)
        # At 30 a second this takes 0.3 s; by the answers' time-out of 0.1 s it took 0.9 s.
        assert time.monotonic() - started_s < 0.7
    assert line.last_line == "7 7"
