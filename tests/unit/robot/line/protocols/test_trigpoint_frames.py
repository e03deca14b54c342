"""Payloads of the serial protocol, and the document that describes them."""

import re
from contextlib import suppress
from pathlib import Path
from uuid import UUID

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trigpoint.base.errors import MessageError
from trigpoint.geometry import Pose
from trigpoint.robot.line.protocols.framing import Frame, FrameReader
from trigpoint.robot.line.protocols.trigpoint_frames import (
    Acknowledge,
    Content,
    CorrectionFrame,
    Heartbeat,
    Hello,
    Kind,
    OdometryFrame,
    Ping,
    Pong,
    Result,
    TicksFrame,
    decode_payload,
    encode_payload,
)
from trigpoint.robot.line.wheels import WheelGeometry

DOCUMENT = Path(__file__).parents[5] / "docs" / "reference" / "serial.md"

u32 = st.integers(0, 2**32 - 1)
u64 = st.integers(0, 2**64 - 1)
metres = st.floats(-1e5, 1e5)
singles = st.floats(-100, 100, width=32)
texts = st.text(st.characters(codec="ascii"), max_size=64)


@st.composite
def poses(draw: st.DrawFn) -> Pose:
    vector = [draw(metres) for _ in range(3)] + [draw(st.floats(-1.5, 1.5)) for _ in range(3)]
    return Pose.from_vector(vector)


def vectors(count: int) -> st.SearchStrategy[np.ndarray]:
    return st.lists(singles, min_size=count, max_size=count).map(np.array)


def again(content: Content) -> Content:
    kind, payload = encode_payload(content)
    return decode_payload(kind, payload)


@given(st.builds(Hello, version=st.just(1), boot=u32, name=texts, program=texts))
def test_hello_comes_back_as_it_was(hello: Hello) -> None:
    assert again(hello) == hello


@given(
    st.one_of(
        st.builds(Ping, number=u32),
        st.builds(Pong, number=u32, boot=u32, received_ns=u64, sent_ns=u64),
        st.builds(Acknowledge, number=u32, result=st.integers(0, 255), text=texts),
        st.builds(Heartbeat, uptime_ns=u64, received=u32, rejected=u32),
    )
)
def test_small_frames_come_back_as_they_were(content: Content) -> None:
    assert again(content) == content


@given(u32, u64, poses(), vectors(3), vectors(3))
def test_odometry_comes_back_to_the_last_bit_of_a_millimetre(
    boot: int, stamp_ns: int, pose: Pose, linear: np.ndarray, angular: np.ndarray
) -> None:
    back = again(OdometryFrame(boot, stamp_ns, pose, linear, angular))
    assert isinstance(back, OdometryFrame)
    assert (back.boot, back.stamp_ns) == (boot, stamp_ns)
    assert np.array_equal(back.pose.translation, pose.translation)
    np.testing.assert_allclose(back.pose.rotation, pose.rotation, atol=1e-14)
    assert np.array_equal(back.linear, linear)
    assert np.array_equal(back.angular, angular)


@given(u32, st.booleans(), u64, st.uuids(), u64, poses(), vectors(6))
def test_correction_comes_back_as_it_was(
    number: int,
    establishes: bool,
    stamp_ns: int,
    map_id: UUID,
    sequence: int,
    pose: Pose,
    upper: np.ndarray,
) -> None:
    covariance = np.zeros((3, 3))
    covariance[np.triu_indices(3)] = upper
    covariance += np.triu(covariance, 1).T
    sent = CorrectionFrame(number, establishes, stamp_ns, map_id, sequence, pose, covariance)
    back = again(sent)
    assert isinstance(back, CorrectionFrame)
    assert (back.number, back.establishes, back.stamp_ns) == (number, establishes, stamp_ns)
    assert (back.map_id, back.sequence) == (map_id, sequence)
    np.testing.assert_allclose(back.pose.difference(pose), 0, atol=1e-9)
    assert np.array_equal(back.covariance, covariance)


@given(st.integers(0, 255), st.binary(max_size=245))
def test_any_payload_decodes_or_is_refused(kind: int, payload: bytes) -> None:
    with suppress(MessageError):
        content = decode_payload(kind, payload)
        assert kind == encode_payload(content)[0]


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_number_that_is_not_finite_is_refused(bad: float) -> None:
    frame = OdometryFrame(0, 0, Pose.planar(bad, 0, 0), np.zeros(3), np.zeros(3))
    with pytest.raises(MessageError, match="not finite"):
        again(frame)


def test_orientation_that_is_no_unit_quaternion_is_refused() -> None:
    kind, payload = encode_payload(OdometryFrame(0, 0, Pose.identity(), np.zeros(3), np.zeros(3)))
    damaged = payload.replace(np.float64(1).tobytes(), np.float64(2).tobytes())
    with pytest.raises(MessageError, match="unit quaternion"):
        decode_payload(kind, damaged)


def test_hello_of_any_later_version_gives_its_version() -> None:
    kind, payload = encode_payload(Hello(7, 99, "r1", "new"))
    hello = decode_payload(kind, payload + b"whatever comes later")
    assert hello == Hello(7, 99, "", "")


def test_long_text_is_cut_between_characters() -> None:
    back = again(Hello(1, 0, "é" * 40, ""))
    assert isinstance(back, Hello)
    assert back.name == "é" * 32


def documented() -> dict[str, Content]:
    """The document's example frames by name."""
    examples = {}
    for name, digits in re.findall(r"```(\w+)\n([0-9a-f \n]+)```", DOCUMENT.read_text("utf-8")):
        reader = FrameReader()
        [frame] = reader.feed(bytes.fromhex(digits.replace("\n", " ")))
        assert isinstance(frame, Frame)
        examples[name] = decode_payload(frame.kind, frame.payload)
    return examples


def test_every_kind_has_an_example_in_the_document() -> None:
    assert set(documented()) == {kind.name.lower() for kind in Kind}


def test_documents_examples_say_what_the_document_says() -> None:
    examples = documented()
    assert examples["hello"] == Hello(1, 0x12345678, "r1", "rover 1.4")
    assert examples["ping"] == Ping(3)
    assert examples["pong"] == Pong(3, 0x12345678, 2_500_100_000, 2_500_140_000)
    assert examples["acknowledge"] == Acknowledge(41, Result.ACCEPTED, "")
    assert examples["heartbeat"] == Heartbeat(3_000_000_000, 9, 1)
    odometry = examples["odometry"]
    assert isinstance(odometry, OdometryFrame)
    assert (odometry.boot, odometry.stamp_ns) == (0x12345678, 2_500_000_000)
    np.testing.assert_allclose(
        odometry.pose.difference(Pose.planar(1.5, -0.25, np.pi / 2)), 0, atol=1e-12
    )
    assert odometry.linear.tolist() == [0.5, 0, 0]
    assert odometry.angular.tolist() == [0, 0, -0.25]
    metres, track = float(np.float32(0.00025)), float(np.float32(0.3))
    wheels = WheelGeometry(metres, metres, track, 32)
    ticks = TicksFrame(0x12345678, 2_500_000_000, 1500, 0xFFFFFF00, wheels)
    assert examples["ticks"] == ticks
    correction = examples["correction"]
    assert isinstance(correction, CorrectionFrame)
    assert correction.establishes
    assert (correction.number, correction.stamp_ns, correction.sequence) == (41, 2_500_000_000, 40)
    assert correction.map_id == UUID("0f1e2d3c-4b5a-6978-8796-a5b4c3d2e1f0")
    assert correction.pose.translation.tolist() == [3, 1, 0]
    np.testing.assert_allclose(np.sqrt(np.diag(correction.covariance)), [0.01, 0.01, 0.02])


def test_ping_and_pong_are_equally_long() -> None:
    ping, pong = encode_payload(Ping(1))[1], encode_payload(Pong(1, 2, 3, 4))[1]
    assert len(ping) == len(pong)
