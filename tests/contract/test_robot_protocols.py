"""What every robot protocol must do, whatever it speaks."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trigpoint.base.clock import to_ns
from trigpoint.geometry import Pose
from trigpoint.robot.firmware.endpoint import FirmwareEndpoint
from trigpoint.robot.line.protocol import PROTOCOLS, Protocol, Reading, Setup, Takes, make_protocol
from trigpoint.robot.line.protocols.create2 import DIAMETER_M, TICKS, TRACK_M, checksum
from trigpoint.robot.line.protocols.mavlink_frames import dialect
from trigpoint.site.config import RobotConfig, WheelConfig

START_NS = to_ns(100.0)
WHEELS = WheelConfig(0.1, 0.3, 1000)


def opened(name: str, wheels: WheelConfig = WHEELS) -> Protocol:
    config = RobotConfig(port="x", protocol=name, wheels=wheels)
    return make_protocol(Setup("r1", config, 7))


@pytest.mark.parametrize("name", list(PROTOCOLS))
@settings(max_examples=50)
@given(st.lists(st.binary(max_size=300), max_size=10))
def test_no_bytes_make_it_raise_or_claim_a_robot(name: str, pieces: list[bytes]) -> None:
    protocol = opened(name)
    events = [event for piece in pieces for event in protocol.receive(piece, START_NS)]
    assert {type(event).__name__ for event in events} <= {"Damaged", "Missing"}


@pytest.mark.parametrize("name", list(PROTOCOLS))
def test_bytes_mean_the_same_however_they_are_cut(name: str) -> None:
    data = b"\0garbage\0more\0" * 3
    whole, single = opened(name), opened(name)
    at_once = whole.receive(data, START_NS)
    one_by_one = [e for i in range(len(data)) for e in single.receive(data[i : i + 1], START_NS)]
    assert at_once == one_by_one


@pytest.mark.parametrize("name", list(PROTOCOLS))
def test_what_is_due_is_sent_and_then_due_later(name: str) -> None:
    protocol, now_ns, sent = opened(name), START_NS, 0
    for _ in range(200):
        if protocol.due_ns(now_ns) <= now_ns:
            sent += bool(protocol.data_to_send(now_ns))
            assert protocol.due_ns(now_ns) > now_ns
        assert protocol.data_to_send(now_ns) == b""
        protocol.elapse(now_ns)
        now_ns += to_ns(0.05)
    assert sent > 1


@pytest.mark.parametrize("name", list(PROTOCOLS))
def test_reset_begins_anew(name: str) -> None:
    protocol = opened(name)
    first = protocol.data_to_send(START_NS)
    protocol.receive(b"half a frame", START_NS)
    protocol.reset()
    assert protocol.data_to_send(START_NS)[:1] == first[:1]
    assert protocol.receive(b"", START_NS) == []


# ---- sound bytes of each protocol, and what damage makes of them


def trigpoint_bytes() -> bytes:
    robot = FirmwareEndpoint(name="r1", program="test", boot=3)
    poses = [Pose.planar(k, 0, 0) for k in range(20)]
    twist = (np.ones(3), np.ones(3))
    said = [robot.odometry(to_ns(0.02 * k), pose, *twist) for k, pose in enumerate(poses)]
    return b"".join([robot.hello(), *said])


def create2_bytes() -> bytes:
    bodies = [bytes([19, 6, 43, 0, k, 44, 0, k]) for k in range(20)]
    return b"".join(body + bytes([checksum(body)]) for body in bodies)


def mavlink_bytes() -> bytes:
    codec = dialect().MAVLink(None, srcSystem=1, srcComponent=1)
    frames = []
    for k in range(20):
        codec.seq = k
        numbers = (0.0,) * 6
        message = dialect().MAVLink_odometry_message(
            20_000 * k, 1, 12, float(k), 0.0, 0.0, [1.0, 0.0, 0.0, 0.0], *numbers,
            [0.0] * 21, [0.0] * 21, 0, 0, 0,
        )  # fmt: skip
        frames.append(bytes(message.pack(codec)))
    return b"".join(frames)


def arduino_bytes() -> bytes:
    return b"".join(b"%d %d\r\n" % (100 + 10 * k, 100 + 10 * k) for k in range(20))


CHECKED = {"trigpoint": trigpoint_bytes, "create2": create2_bytes, "mavlink": mavlink_bytes}
"""Protocols whose frames carry a check; ros_arduino_bridge's lines have none."""


def readings(name: str, data: bytes, cut: int = 0) -> list[Reading]:
    protocol = opened(name)
    pieces = [data[:cut], data[cut:]] if cut else [data]
    events = [event for piece in pieces for event in protocol.receive(piece, START_NS)]
    return [event for event in events if isinstance(event, Reading)]


@pytest.mark.parametrize("name", list(CHECKED))
def test_sound_bytes_are_readings_however_they_are_cut(name: str) -> None:
    data = CHECKED[name]()
    whole = readings(name, data)
    assert len(whole) == 20
    for cut in range(1, len(data), 23):
        assert len(readings(name, data, cut)) == 20


@pytest.mark.parametrize("name", list(CHECKED))
@settings(max_examples=40)
@given(data=st.data())
def test_damaged_bytes_cost_one_or_two_readings_and_make_up_none(
    name: str, data: st.DataObject
) -> None:
    sound = CHECKED[name]()
    frame = len(sound) // 20
    at = data.draw(st.integers(8 * frame, 12 * frame))
    garbage = data.draw(st.binary(min_size=1, max_size=3))
    damaged = sound[:at] + garbage + sound[at + len(garbage) :]
    taken = {tuple(reading.pose.translation.round(6)) for reading in readings(name, sound)}
    found = [tuple(reading.pose.translation.round(6)) for reading in readings(name, damaged)]
    # A byte check of eight bits lets one in 256 through, if it falls on the check byte's match.
    assert len(found) >= 17
    if name != "create2":
        assert set(found) <= taken


Damage = tuple[str, float, bytes]
Stream = list[tuple[int, list[Damage]]]
DAMAGES = st.tuples(
    st.sampled_from(["flipped", "cut", "doubled", "replaced"]),
    st.floats(0.0, 1.0),
    st.binary(min_size=1, max_size=9),
)
STREAMS = st.lists(st.tuples(st.integers(0, 17), st.lists(DAMAGES, max_size=2)), max_size=12)
"""Stretches of three sound frames, from the one of a number on, and what becomes of each."""


def damaged(data: bytes, damages: list[Damage]) -> bytes:
    for kind, share, noise in damages:
        at, length = int(share * (len(data) - 1)), len(noise)
        head, here, rest = data[:at], data[at : at + length], data[at + length :]
        match kind:
            case "flipped":
                data = head + bytes([data[at] ^ (1 << (noise[0] % 8))]) + data[at + 1 :]
            case "cut":
                data = head + rest
            case "doubled":
                data = head + here + here + rest
            case _:
                data = head + noise + rest
    return data


def heard(
    name: str, sound: bytes, stream: Stream, wheels: WheelConfig
) -> tuple[bytes, list[Reading]]:
    """All bytes of a damaged stream, and what the protocol reads in them."""
    frame = len(sound) // 20
    pieces = [damaged(sound[frame * k : frame * (k + 3)], damages) for k, damages in stream]
    pieces.insert(0, sound[:frame])
    protocol, events = opened(name, wheels), []
    for k, piece in enumerate(pieces):
        now_ns = START_NS + k * to_ns(0.1)
        protocol.data_to_send(now_ns)
        events += protocol.receive(piece, now_ns)
    return b"".join(pieces), [event for event in events if isinstance(event, Reading)]


@pytest.mark.parametrize("name", ["trigpoint", "mavlink"])
@settings(max_examples=75)
@given(stream=STREAMS)
def test_damaged_stream_has_no_reading_that_was_not_sent(name: str, stream: Stream) -> None:
    for reading in heard(name, CHECKED[name](), stream, WHEELS)[1]:
        x, *rest = reading.pose.translation.tolist()
        assert x in range(20)
        assert reading.firmware_ns == round(x) * to_ns(0.02)
        assert rest == [0.0, 0.0]
        np.testing.assert_array_equal(reading.pose.rotation, np.eye(3))


def create2_counts(data: bytes) -> set[tuple[int, int]]:
    """The encoders' counts in all frames that a byte-wise look finds, whatever lies around them."""
    frames = [data[k : k + 9] for k in range(len(data) - 8)]
    return {
        (frame[3] << 8 | frame[4], frame[6] << 8 | frame[7])
        for frame in frames
        if frame[:3] == b"\x13\x06\x2b" and frame[5] == 44 and sum(frame) % 256 == 0
    }


@settings(max_examples=75)
@given(stream=STREAMS)
def test_damaged_counters_lead_from_sound_counts_to_sound_counts(stream: Stream) -> None:
    wheels = WheelConfig(DIAMETER_M, TRACK_M, TICKS)
    data, found = heard("create2", create2_bytes(), stream, wheels)
    sound, wrap, tick_m = create2_counts(data), 1 << 16, np.pi * DIAMETER_M / TICKS
    reached = sound
    for before, after in pairwise(found):
        elapsed_s = (after.firmware_ns - before.firmware_ns) / 1e9
        way = float(after.linear[0]) * elapsed_s / tick_m
        turn = 0.5 * TRACK_M * float(after.angular[2]) * elapsed_s / tick_m
        left, right = round(way - turn), round(way + turn)
        reached = reached & {((a - left) % wrap, (b - right) % wrap) for a, b in sound}
        reached = {((a + left) % wrap, (b + right) % wrap) for a, b in reached}
        assert reached


@settings(max_examples=75)
@given(stream=STREAMS)
def test_damaged_lines_without_a_check_are_read_or_left_out(stream: Stream) -> None:
    for reading in heard("ros_arduino_bridge", arduino_bytes(), stream, WHEELS)[1]:
        assert np.isfinite(reading.pose.translation).all()
        assert np.isfinite(reading.linear).all()


@pytest.mark.parametrize("name", list(PROTOCOLS))
def test_traits_say_what_cannot_be_carried(name: str) -> None:
    traits = opened(name).traits
    assert (traits.takes is Takes.CORRECTIONS) == (not traits.lacks)
