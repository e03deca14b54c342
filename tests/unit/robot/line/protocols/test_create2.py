"""iRobot's Open Interface; the bytes are those of iRobot's specification."""

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from trigpoint.base.clock import to_ns
from trigpoint.robot.line.protocol import Connected, Damaged, Event, Reading, Setup, Silent
from trigpoint.robot.line.protocols.create2 import REQUEST, Create2, StreamReader, checksum
from trigpoint.site.config import RobotConfig

# «Stream», the specification's example: cliff left signal (29) and virtual wall (13).
SPECIFIED = bytes([19, 5, 29, 2, 25, 13, 0, 163])
NOW_NS = to_ns(10.0)


def frame(left: int, right: int) -> bytes:
    body = bytes([19, 6, 43, *left.to_bytes(2, "big"), 44, *right.to_bytes(2, "big")])
    return body + bytes([checksum(body)])


def robot() -> Create2:
    return Create2(Setup("r1", RobotConfig(port="x", protocol="create2"), 1))


def readings(events: list[Event]) -> list[Reading]:
    return [event for event in events if isinstance(event, Reading)]


def test_the_specifications_own_frame_is_sound() -> None:
    assert checksum(SPECIFIED[:-1]) == 163
    found, damaged = StreamReader(5).feed(SPECIFIED)
    assert found == [SPECIFIED[2:-1]]
    assert damaged == 0
    assert int.from_bytes(found[0][1:3], "big") == 2 * 256 + 25


def test_it_starts_the_interface_and_asks_for_both_encoders() -> None:
    assert robot().data_to_send(NOW_NS) == REQUEST == bytes([128, 148, 2, 43, 44])


def test_first_frame_connects_and_counts_become_a_way() -> None:
    create = robot()
    assert [type(event) for event in create.receive(frame(100, 100), NOW_NS)] == [
        Connected,
        Reading,
    ]
    turn = round(508.8 * 10)  # ten turns of a wheel of 72 mm
    found = readings(create.receive(frame(100 + turn, 100 + turn), NOW_NS + to_ns(0.015)))
    np.testing.assert_allclose(found[0].pose.translation[0], 10 * np.pi * 0.072, atol=1e-3)


def test_encoders_wrap_at_sixteen_bits() -> None:
    create = robot()
    create.receive(frame(65_530, 65_530), NOW_NS)
    [reading] = readings(create.receive(frame(4, 4), NOW_NS + to_ns(0.015)))
    np.testing.assert_allclose(reading.pose.translation[0], 10 * np.pi * 0.072 / 508.8)


def test_wrong_checksum_is_thrown_away_and_the_next_frame_read() -> None:
    create = robot()
    create.receive(frame(1, 1), NOW_NS)
    bad = bytearray(frame(2, 2))
    bad[3] ^= 4
    events = create.receive(bytes(bad) + frame(3, 3), NOW_NS + to_ns(0.015))
    assert len(readings(events)) == 1
    assert sum(isinstance(event, Damaged) for event in events) == 1


def test_chatter_before_the_first_frame_is_no_damage() -> None:
    """A Roomba says its version and battery as text when it wakes."""
    events = robot().receive(b"bl-start\r\nSTR730\r\n" + frame(1, 1), NOW_NS)
    assert [type(event) for event in events] == [Connected, Reading]


def test_readings_of_one_piece_have_stamps_of_their_own() -> None:
    create = robot()
    events = create.receive(frame(1, 1) + frame(2, 2) + frame(3, 3), NOW_NS)
    stamps = [reading.firmware_ns for reading in readings(events)]
    assert np.diff(stamps).tolist() == [to_ns(0.015)] * 2
    assert stamps[-1] <= NOW_NS


def test_silence_is_told_and_the_stream_asked_for_again() -> None:
    create = robot()
    create.data_to_send(NOW_NS)
    create.receive(frame(1, 1), NOW_NS)
    assert create.data_to_send(NOW_NS + to_ns(1.0)) == b""
    later_ns = NOW_NS + to_ns(1.5)
    assert [type(event) for event in create.elapse(later_ns)] == [Silent]
    assert create.data_to_send(later_ns) == REQUEST


@given(st.binary(max_size=40), st.lists(st.integers(0, 50), max_size=6))
def test_sound_frame_after_any_garbage_is_found(garbage: bytes, cuts: list[int]) -> None:
    """At the latest the second: garbage may look like the beginning of a frame."""
    data = garbage + frame(7, 9) + frame(8, 10)
    create, found = robot(), []
    edges = sorted({0, len(data), *(cut for cut in cuts if cut < len(data))})
    for begin, end in pairwise(edges):
        found += readings(create.receive(data[begin:end], NOW_NS))
    assert found
