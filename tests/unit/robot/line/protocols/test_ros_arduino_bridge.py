"""ros_arduino_bridge's commands; the bytes are those of its sketch (ROSArduinoBridge.ino)."""

import re
from collections import deque
from collections.abc import Callable, Container, Iterable
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from trigpoint.base.clock import to_ns
from trigpoint.robot.line.limits import Motion, MotionLimits
from trigpoint.robot.line.protocol import (
    Advice,
    Connected,
    Damaged,
    Event,
    Mismatched,
    Missing,
    Reading,
    Setup,
)
from trigpoint.robot.line.protocols.ros_arduino_bridge import ENCODERS, RosArduinoBridge
from trigpoint.site.config import RobotConfig, WheelConfig

# The README's robot: 0.146 m wheels, 0.2969 m apart, 8384 counts a turn.
README = WheelConfig(0.146, 0.2969, 8384)
NOW_NS = to_ns(10.0)
ANSWER_NS = to_ns(0.004)
COUNTS_A_SECOND = 0.5 * 8384 / (np.pi * 0.146)  # of a robot at 0.5 m/s
Span = tuple[float, float]
"""From when on, seconds, and for how long."""
# One a second, and two at a time shorter than what a lost answer is waited for.
SPANS = st.lists(st.tuples(st.floats(0.1, 0.6), st.floats(0.0, 0.12)), max_size=5).map(
    lambda drawn: [(1.0 + second + start, length) for second, (start, length) in enumerate(drawn)]
)


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
    assert readings(events) == []  # it may be a late answer to the first question
    assert len(readings(asked(protocol, board, lost_ns + to_ns(0.37)))) == 1


def test_late_answer_is_no_reading() -> None:
    protocol = opened()
    protocol.data_to_send(NOW_NS)
    protocol.receive(b"0 0\r\n", NOW_NS)
    assert readings(protocol.receive(b"5 5\r\n", NOW_NS + to_ns(0.01))) == []


class Held:
    """A board at 0.5 m/s and the bridge's two threads, each held up where it is said, and answers
    lost. Everything comes as late as that, and in order."""

    def __init__(self, board: list[Span], reader: list[Span], lost: Container[int] = ()) -> None:
        self._board, self._reader, self._lost = board, reader, lost
        self.protocol, self.events = opened(), []
        self._line: deque[bytes] = deque()
        self._here: list[bytes] = []

    def run(self, seconds: float, tick_s: float = 0.002) -> list[Event]:
        asked = 0
        for now_s in np.arange(0.0, seconds, tick_s).tolist():
            now_ns = NOW_NS + to_ns(now_s)
            self.events += self.protocol.elapse(now_ns)
            if ENCODERS in (sent := self.protocol.data_to_send(now_ns)):
                asked += 1
                if asked not in self._lost:
                    self._line.append(sent)
            while self._line and not _within(now_s, self._board):
                self._line.popleft()
                count = int(COUNTS_A_SECOND * now_s)
                self._here.append(b"%d %d\r\n" % (count, count))
            if self._here and not _within(now_s, self._reader):
                self.events += self.protocol.receive(b"".join(self._here), now_ns)
                self._here.clear()
        return self.events


def _within(now_s: float, spans: list[Span]) -> bool:
    return any(start <= now_s < start + length for start, length in spans)


def check_times(events: list[Event], limits: MotionLimits) -> list[Reading]:
    """Every reading was taken when it is said to have been, and no step is impossible."""
    found = readings(events)
    for reading in found:
        truth_s = float(reading.pose.translation[0] / 0.5) + 1 / COUNTS_A_SECOND
        off_s = (reading.firmware_ns - NOW_NS) / 1e9 - truth_s
        assert abs(off_s) <= reading.doubt_ns / 1e9 + 0.004
        assert reading.doubt_ns <= to_ns(0.05)
        motion = limits.look(reading.firmware_ns, reading.pose, reading.doubt_ns)
        assert motion is Motion.POSSIBLE
    return found


@settings(max_examples=25)
@example(board=[], reader=[(0.35, 1.2)])  # as where what handles a reading is first imported
@example(board=[(0.35, 1.2)], reader=[])
@example(board=[(0.35, 1.2)], reader=[(0.5, 1.5)])
@given(SPANS, SPANS)
def test_answers_that_come_bunched_and_late_are_stamped_when_they_were_read(
    board: list[Span], reader: list[Span]
) -> None:
    limits = MotionLimits(RobotConfig(port="x", max_speed=0.55))
    found = check_times(Held(board, reader).run(6.0), limits)
    held_s = sum(length + 0.3 for _, length in board + reader)
    assert len(found) >= 25 * (6.0 - held_s)
    assert found[-1].firmware_ns > NOW_NS + to_ns(5.9)


@settings(max_examples=25)
@given(st.lists(st.integers(3, 60), max_size=6, unique=True))
def test_lost_answers_cost_half_a_second_each_and_shift_none(lost: list[int]) -> None:
    limits = MotionLimits(RobotConfig(port="x", max_speed=0.55))
    found = check_times(Held([], [], lost).run(6.0), limits)
    assert len(found) >= 28 * (6.0 - 0.5 * len(lost))
    assert found[-1].firmware_ns > NOW_NS + to_ns(5.4)


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


ASKED_S = 0.034  # nearly 30 times a second
Answer = Callable[[int], str]


def driven(
    protocol: RosArduinoBridge,
    lefts: Iterable[tuple[float, int]],
    answer: Answer = lambda n: f"{n} {n}",
) -> list[Event]:
    """The events of answers at given times (s), of wheels that turn alike."""
    events: list[Event] = []
    for seconds, count in lefts:
        now_ns = NOW_NS + to_ns(seconds)
        events += protocol.elapse(now_ns)
        protocol.data_to_send(now_ns)
        events += protocol.receive(f"{answer(count)}\r\n".encode(), now_ns + 1000)
    return events


def way(events: list[Event]) -> float:
    """How far a robot that drives straight came, restarts told by the reading at the origin."""
    last = total = 0.0
    for reading in readings(events):
        x = float(reading.pose.translation[0])
        total, last = total + (x - last if x else 0.0), x
    return total


def steady(start_s: float, seconds: float, first: float = 0.0) -> list[tuple[float, int]]:
    times = np.arange(start_s, start_s + seconds, ASKED_S)
    return [(t, int(first + COUNTS_A_SECOND * (t - start_s))) for t in times.tolist()]


@pytest.mark.parametrize(
    "answer",
    [
        lambda n: f"{n} {n} ",
        lambda n: f" {n}\t{n}\r\r",
        lambda n: f"{n},{n}",
        lambda n: f"{n}; {n}",
        lambda n: f"{n}.00 {n}.00",
        lambda n: f"e\r\n{n} {n}",
    ],
)
def test_answers_of_forks_are_read_where_their_meaning_is_plain(answer: Answer) -> None:
    events = driven(opened(), steady(0.0, 1.0), answer)
    assert len(readings(events)) == 30
    assert way(events) == pytest.approx(0.5 * 29 * ASKED_S, abs=0.001)


@pytest.mark.parametrize("answer", [lambda n: f"{n},5 {n},5", lambda n: f"L:{n} R:{n}"])
def test_answer_that_could_mean_anything_is_told_with_its_line(answer: Answer) -> None:
    events = driven(opened(), steady(0.0, 1.0), answer)
    [told] = [event for event in events if isinstance(event, Damaged) and event.text]
    assert f"«{answer(int(COUNTS_A_SECOND * 2 * ASKED_S))}»" in told.text
    assert readings(events) == []


def test_board_that_refuses_the_question_is_told_now_and_then() -> None:
    events = driven(opened(), steady(0.0, 9.0), lambda _: "Invalid Command")
    told = [event for event in events if isinstance(event, Mismatched)]
    assert ["«Invalid Command»" in event.text for event in told] == [True, True]


@pytest.mark.parametrize("quick", [0, 1])
@pytest.mark.parametrize(("delay_s", "is_told"), [(0.15, True), (0.4, True), (0.05, False)])
def test_board_that_answers_too_late_is_told_so_and_not_asked_for_its_protocol(
    delay_s: float, is_told: bool, quick: int
) -> None:
    """One that works through its questions one by one, and waits with each but the first ones."""
    protocol, events, free_s, was_quick = opened(), list[Event](), 0.0, quick
    due = deque[float]()
    for now_s in np.arange(0.0, 12.0, 0.01).tolist():
        now_ns = NOW_NS + to_ns(now_s)
        events += protocol.elapse(now_ns)
        for _ in range(protocol.data_to_send(now_ns).count(ENCODERS)):
            free_s = max(free_s, now_s) + (0.0 if quick else delay_s)
            quick = max(quick - 1, 0)
            due.append(free_s)
        while due and due[0] <= now_s:
            due.popleft()
            events += protocol.receive(b"700 800\r\n", now_ns)
    told = [event.text for event in events if isinstance(event, Mismatched)]
    assert len(told) == (2 if is_told else 0)
    assert all(re.search(r"«700 800», but for the last \d s later than 0\.1 s", t) for t in told)
    assert protocol._is_connected is not is_told
    assert len(readings(events)) == was_quick if is_told else len(readings(events)) > 150


@pytest.mark.parametrize("order", ["lrlr", "llrr", "lr--"])
def test_four_counts_are_read_by_their_order(order: str) -> None:
    columns = {"l": "100", "r": "300", "-": "77"}
    answer = " ".join(columns[side] for side in order)
    events = driven(opened(), [(0.1 * k, k) for k in range(4)], lambda _: answer)
    assert 'order = "lrlr"' in next(e.text for e in events if isinstance(e, Mismatched))
    ordered = opened(WheelConfig(0.146, 0.2969, 8384, order=order))
    driven(ordered, [(0.0, 0)], lambda _: "0 0 0 0")
    [reading] = readings(driven(ordered, [(0.1, 0)], lambda _: answer))
    assert reading.pose.heading == pytest.approx(200 * np.pi * 0.146 / 8384 / 0.2969)


@settings(max_examples=20)
@given(st.integers(-(2**15), 2**16), st.sampled_from([16, None]))
def test_counters_of_16_bits_wrap_without_a_jump(first: int, bits: int | None) -> None:
    """Stated, or noticed where a step is possible in no other way, which is told once."""
    protocol = opened(WheelConfig(0.146, 0.2969, 8384, bits=bits))
    counts = [(t, (count + 2**15) % 2**16 - 2**15) for t, count in steady(0.0, 12.0, first)]
    events = driven(protocol, counts)
    wraps = any(abs(b[1] - a[1]) > 2**15 for a, b in pairwise(counts))
    assert sum(isinstance(event, Advice) for event in events) == (wraps and bits is None)
    xs = [float(reading.pose.translation[0]) for reading in readings(events)]
    np.testing.assert_allclose(np.diff(xs), 0.5 * ASKED_S, atol=0.001)


@settings(max_examples=20)
@example(7.17, 0.3, 0.0)  # counts that 16 bits would just not hold
@given(st.floats(0.5, 20.0), st.floats(0.3, 8.0), st.floats(0.0, 0.1))
def test_board_that_counts_from_zero_goes_on_where_it_was(
    drove_s: float, silent_s: float, begun_s: float
) -> None:
    protocol, again_s = opened(), drove_s + silent_s
    events = driven(protocol, steady(0.0, drove_s))
    [*_, last] = readings(events)
    events = driven(protocol, steady(again_s, 1.0, COUNTS_A_SECOND * begun_s))
    [connected] = [event for event in events if isinstance(event, Connected)]
    assert connected.boot == 1
    assert float(readings(events)[0].pose.translation[0]) == 0.0
    assert way(events) == pytest.approx(0.5 * 29 * ASKED_S, abs=0.02)
    assert float(last.pose.translation[0]) > 0.2


@settings(max_examples=20)
@given(st.floats(0.5, 20.0), st.floats(0.3, 8.0), st.booleans())
def test_board_that_was_only_silent_went_on_counting(
    drove_s: float, silent_s: float, stands: bool
) -> None:
    protocol, again_s = opened(), drove_s + silent_s
    driven(protocol, steady(0.0, drove_s))
    count = COUNTS_A_SECOND * (drove_s if stands else again_s)
    events = driven(protocol, [(again_s, int(count))])
    assert all(event.boot == 0 for event in events if isinstance(event, Connected))
    x = count * np.pi * 0.146 / 8384
    assert float(readings(events)[0].pose.translation[0]) == pytest.approx(x, abs=0.001)
