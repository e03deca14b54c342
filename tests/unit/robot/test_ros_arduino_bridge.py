"""ros_arduino_bridge's commands; the bytes are those of its sketch (ROSArduinoBridge.ino)."""

import numpy as np
import pytest

from trigpoint.clock import to_ns
from trigpoint.config import RobotConfig, WheelConfig
from trigpoint.robot.protocol import Connected, Damaged, Event, Mismatched, Missing, Reading, Setup
from trigpoint.robot.protocols.ros_arduino_bridge import RosArduinoBridge

# The README's robot: 0.146 m wheels, 0.2969 m apart, 8384 counts a turn.
README = WheelConfig(0.146, 0.2969, 8384)
NOW_NS = to_ns(10.0)
ANSWER_NS = to_ns(0.004)


class Board:
    """The sketch, as far as it is needed: commands end with CR, answers with CR LF."""

    def __init__(self) -> None:
        self.left = self.right = 5
        self._command = b""

    def receive(self, data: bytes) -> bytes:
        answer = b""
        for byte in data:
            if byte != 13:
                self._command += bytes([byte])
                continue
            command, self._command = self._command, b""
            if command == b"e":
                answer += b"%d %d\r\n" % (self.left, self.right)
            elif command == b"r":
                self.left = self.right = 0
                answer += b"OK\r\n"
            else:
                answer += b"Invalid Command\r\n"
        return answer


def opened(wheels: WheelConfig = README) -> RosArduinoBridge:
    config = RobotConfig(port="x", protocol="ros_arduino_bridge", wheels=wheels)
    return RosArduinoBridge(Setup("r1", config, 1))


def asked(protocol: RosArduinoBridge, board: Board, now_ns: int) -> list[Event]:
    """One question and its answer."""
    events = protocol.elapse(now_ns)
    answer = board.receive(protocol.data_to_send(now_ns))
    return events + (protocol.receive(answer, now_ns + ANSWER_NS) if answer else [])


def readings(events: list[Event]) -> list[Reading]:
    return [event for event in events if isinstance(event, Reading)]


def test_bytes_are_those_of_the_sketch() -> None:
    protocol = opened()
    assert protocol.data_to_send(NOW_NS) == b"\rr\re\r"
    assert protocol.receive(b"Invalid Command\r\nOK\r\n", NOW_NS) == []
    events = protocol.receive(b"0 0\r\n", NOW_NS)
    assert [type(event) for event in events] == [Connected, Reading]
    later_ns = NOW_NS + to_ns(0.05)
    assert protocol.data_to_send(later_ns) == b"e\r"
    [reading] = readings(protocol.receive(b"8384 8384\r\n", later_ns))
    np.testing.assert_allclose(reading.pose.translation[0], np.pi * 0.146)


def test_reading_is_stamped_between_question_and_answer() -> None:
    protocol, board = opened(), Board()
    [reading] = readings(asked(protocol, board, NOW_NS))
    assert reading.firmware_ns == NOW_NS + ANSWER_NS // 2


def test_counters_are_set_to_zero_once_and_not_when_the_port_comes_back() -> None:
    protocol, board = opened(), Board()
    asked(protocol, board, NOW_NS)
    board.left = board.right = 700
    protocol.reset()
    [reading] = readings(asked(protocol, board, NOW_NS + to_ns(1.0)))
    assert board.left == 700
    np.testing.assert_allclose(reading.pose.translation[0], 700 * np.pi * 0.146 / 8384)


def test_question_without_an_answer_is_counted_and_asked_again() -> None:
    protocol, board = opened(), Board()
    asked(protocol, board, NOW_NS)
    lost_ns = NOW_NS + to_ns(0.05)
    assert protocol.data_to_send(lost_ns) == b"e\r"
    assert protocol.data_to_send(lost_ns + to_ns(0.05)) == b""
    events = asked(protocol, board, lost_ns + to_ns(0.11))
    assert Missing(1) in events
    assert len(readings(events)) == 1


def test_late_answer_is_no_reading() -> None:
    protocol = opened()
    protocol.data_to_send(NOW_NS)
    protocol.receive(b"0 0\r\n", NOW_NS)
    assert readings(protocol.receive(b"5 5\r\n", NOW_NS + to_ns(0.01))) == []


@pytest.mark.parametrize("line", [b"12", b"1 2 3", b"1.5 2", b"x 4", b"99999999999 1", b"-- 1"])
def test_line_that_is_no_answer_is_damage(line: bytes) -> None:
    protocol, board = opened(), Board()
    asked(protocol, board, NOW_NS)
    protocol.data_to_send(NOW_NS + to_ns(0.05))
    events = protocol.receive(line + b"\r\n", NOW_NS + to_ns(0.06))
    assert [type(event) for event in events] == [Damaged]


def test_missing_wheel_numbers_are_asked_for_by_name() -> None:
    protocol, board = opened(WheelConfig()), Board()
    [event] = asked(protocol, board, NOW_NS)
    assert isinstance(event, Mismatched)
    assert "write diameter, track and ticks under [robots.r1.wheels]" in event.text


def test_endless_line_takes_no_memory() -> None:
    protocol, board = opened(), Board()
    asked(protocol, board, NOW_NS)
    for _ in range(100):
        protocol.receive(b"1" * 1000, NOW_NS)
    assert len(protocol._buffer) <= 64
    assert [type(event) for event in protocol.receive(b"\n", NOW_NS)] == [Damaged]
