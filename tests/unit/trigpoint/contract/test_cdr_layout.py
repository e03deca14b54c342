"""Held against rosbags, which reads the same bytes by the types' definitions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from support.messages import (
    assert_equal,
    covariances,
    estimates,
    messages,
    names,
    odometry,
    poses,
    stamps,
    vectors,
)

from trigpoint.base.errors import MessageError
from trigpoint.contract import cdr_layout
from trigpoint.contract.cdr import (
    LAYOUTS,
    decode,
    decode_by_definition,
    encode,
    encode_by_definition,
    type_name,
)
from trigpoint.contract.cdr_writing import quickly_written
from trigpoint.contract.messages import (
    ODOMETRY,
    POSE_ESTIMATE,
    SIGHTINGS,
    FaceSighting,
    Message,
    Odometry,
    PoseEstimate,
    PoseStamped,
    Sightings,
    Transforms,
)
from trigpoint.geometry import Pose

WRITTEN = (Odometry, Sightings, PoseEstimate, PoseStamped, Transforms)


def by_layout(name: str, payload: bytes) -> Message | None:
    """None where the type has no layout, or it is left to the definition."""
    return LAYOUTS[name](payload) if name in LAYOUTS else None


def is_read(name: str, payload: bytes) -> bool:
    try:
        return by_layout(name, payload) is not None
    except MessageError:
        return False


@settings(max_examples=300)
@given(messages)
def test_sound_message_is_read_and_written_as_by_its_definition(message: Message) -> None:
    name, payload = type_name(message), encode(message)
    if name in LAYOUTS:
        assert_equal(by_layout(name, payload), decode_by_definition(name, payload))
    quickly = quickly_written(message)
    assert isinstance(message, WRITTEN) is (quickly is not None)
    assert quickly is None or quickly == encode_by_definition(message)


@pytest.mark.parametrize("stamp_ns", [-1, 2**31 * 10**9])
def test_stamp_that_no_message_holds_is_left_to_the_definition(stamp_ns: int) -> None:
    assert quickly_written(PoseStamped(stamp_ns, "", Pose.identity())) is None


@settings(max_examples=300)
@given(messages, st.data())
def test_damaged_message_is_refused_or_read_as_by_its_definition(
    message: Message, data: st.DataObject
) -> None:
    payload = bytearray(encode(message))
    for _ in range(data.draw(st.integers(0, 3))):
        payload[data.draw(st.integers(0, len(payload) - 1))] = data.draw(st.integers(0, 255))
    length = data.draw(st.integers(0, len(payload) + 5))
    damaged = bytes(payload[:length]) + bytes(max(0, length - len(payload)))
    try:
        read = by_layout(type_name(message), damaged)
    except MessageError:  # beyond all measure, which its definition is not asked about any more
        read = None
    try:
        expected = decode_by_definition(type_name(message), damaged)
    except MessageError:
        assert read is None
    else:
        assert read is None or assert_equal(read, expected) is None


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf])
def test_odometry_with_a_place_that_is_not_finite_is_refused(number: float) -> None:
    translation = np.array([1.0, number, -number])
    message = Odometry(1, "r1/odom", "r1/base", Pose(np.eye(3), translation))
    with pytest.raises(MessageError, match="not finite"):
        decode(type_name(message), encode(message))


def test_big_endian_message_is_left_to_the_definition() -> None:
    message = Odometry(7, "r1/odom", "r1/base", Pose.identity())
    assert cdr_layout.odometry(b"\x00\x00" + encode(message)[2:]) is None


def test_too_many_faces_are_refused_before_one_is_read() -> None:
    face = FaceSighting("t", 1, np.arange(4, dtype=np.uint16), np.zeros((4, 2), np.float32), 0.2)
    payload = encode(Sightings(1, "c1/optical", 640, 480, (face,) * 5000))
    with pytest.raises(MessageError, match="5000 faces, of which 256"):
        decode(SIGHTINGS, payload)


def test_name_of_a_megabyte_is_refused() -> None:
    with pytest.raises(MessageError, match="bytes of a name"):
        decode(SIGHTINGS, encode(Sightings(1, "x" * 1_000_000, 640, 480, ())))


@given(st.lists(st.tuples(stamps, poses, vectors), min_size=1, max_size=9), names, names)
def test_messages_of_one_robot_are_read_at_once_as_each(
    drawn: list[tuple[int, Pose, np.ndarray]], frame: str, child: str
) -> None:
    payloads = [encode(Odometry(ns, frame, child, pose, v, v)) for ns, pose, v in drawn]
    read = cdr_layout.odometry_run(payloads)
    assert read is not None
    stamps_ns, found = read
    each = [decode(ODOMETRY, payload) for payload in payloads]
    assert stamps_ns.tolist() == [message.stamp_ns for message in each]  # pyright: ignore[reportAttributeAccessIssue]
    expected = Pose.stack([message.pose for message in each])  # pyright: ignore[reportAttributeAccessIssue]
    assert found.rows().tobytes() == expected.rows().tobytes()


@given(st.lists(st.tuples(stamps, poses, covariances), min_size=1, max_size=9), names)
def test_poses_of_many_are_read_at_once_as_each(
    drawn: list[tuple[int, Pose, np.ndarray]], frame: str
) -> None:
    payloads = [encode(PoseEstimate(ns, frame, pose, known)) for ns, pose, known in drawn]
    read = cdr_layout.pose_estimate_run(payloads, frame)
    assert read is not None
    stamps_ns, found, known = read
    each = [cdr_layout.pose_estimate(payload) for payload in payloads]
    sound = [message for message in each if message is not None]
    assert stamps_ns.tolist() == [message.stamp_ns for message in sound]
    assert found.rows().tobytes() == Pose.stack([m.pose for m in sound]).rows().tobytes()
    assert known.tobytes() == np.stack([message.covariance for message in sound]).tobytes()
    assert cdr_layout.pose_estimate_run(payloads, f"{frame}/other") is None


@given(estimates, estimates, st.data())
def test_poses_of_which_one_is_not_sound_are_left_to_each(
    first: PoseEstimate, second: PoseEstimate, data: st.DataObject
) -> None:
    payloads = [encode(first), bytearray(encode(second))]
    payloads[1][data.draw(st.integers(0, len(payloads[1]) - 1))] = data.draw(st.integers(0, 255))
    is_sound = all(is_read(POSE_ESTIMATE, bytes(each)) for each in payloads)
    read = cdr_layout.pose_estimate_run([bytes(each) for each in payloads], first.frame_id)
    assert read is None or is_sound


@pytest.mark.parametrize("name", ["x" * 300, "x" * 254])
def test_a_run_with_a_name_that_is_too_long_is_left_to_each(name: str) -> None:
    estimate = encode(PoseEstimate(0, name, Pose.identity(), np.eye(6)))
    assert (cdr_layout.pose_estimate_run([estimate], name) is None) is (len(name) > 255)
    moved = encode(Odometry(0, name, "", Pose.identity()))
    assert (cdr_layout.odometry_run([moved]) is None) is (len(name) > 255)


@given(odometry, odometry, st.data())
def test_run_with_a_message_that_is_not_sound_is_left_to_each(
    first: Odometry, second: Odometry, data: st.DataObject
) -> None:
    payloads = [encode(first), bytearray(encode(second))]
    payloads[1][data.draw(st.integers(0, len(payloads[1]) - 1))] = data.draw(st.integers(0, 255))
    is_sound = all(is_read(ODOMETRY, bytes(each)) for each in payloads)
    read = cdr_layout.odometry_run([bytes(each) for each in payloads])
    assert read is None or is_sound


@given(st.lists(odometry, min_size=2, max_size=4), st.integers(10**9, 2**32 - 1), st.data())
def test_a_run_with_a_stamp_that_is_none_is_left_to_each(
    several: list[Odometry], part: int, data: st.DataObject
) -> None:
    alike = [replace(each, frame_id="o", child_frame_id="b") for each in several]
    assert cdr_layout.odometry_run([encode(each) for each in alike]) is not None
    payloads = [bytearray(encode(each)) for each in alike]
    payloads[data.draw(st.integers(0, len(payloads) - 1))][8:12] = part.to_bytes(4, "little")
    assert cdr_layout.odometry_run([bytes(each) for each in payloads]) is None
