from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from support.messages import assert_equal
from support.messages import messages as drawn_messages

from trigpoint.base.errors import MessageError
from trigpoint.contract import messages
from trigpoint.contract.cdr import (
    decode,
    definition,
    encode,
    fault_in,
    type_hash,
    type_name,
    warm_up,
)
from trigpoint.contract.messages import (
    Diagnostics,
    DiagnosticStatus,
    FaceSighting,
    Message,
    OccupancyGrid,
    Odometry,
    Polygon,
    PoseEstimate,
    PoseStamped,
    Sightings,
)
from trigpoint.contract.topics import TOPICS
from trigpoint.geometry import Pose


@settings(max_examples=100)
@given(drawn_messages)
def test_message_survives_the_way_to_bytes_and_back(message: Message) -> None:
    payload = encode(message)
    assert payload[:4] == b"\x00\x01\x00\x00"  # CDR, little-endian
    assert_equal(message, decode(type_name(message), payload), atol=1e-12)


@settings(max_examples=100)
@given(st.sampled_from(TOPICS), st.binary(max_size=300))
def test_garbage_is_a_message_error(topic: object, payload: bytes) -> None:
    assert is_refused_or_decoded(getattr(topic, "type_name"), payload)  # noqa: B009


def is_refused_or_decoded(name: str, payload: bytes) -> bool:
    """Whether bytes are a message of the type or refused as none; any other error comes through."""
    try:
        return type_name(decode(name, payload)) == name
    except MessageError:
        return True


def test_every_topic_has_a_codec() -> None:
    warm_up()
    for topic in TOPICS:
        assert type_hash(topic.type_name).startswith("RIHS01_")
        assert definition(topic.type_name)


def test_sightings_definition_holds_the_faces_definition() -> None:
    text = definition(messages.SIGHTINGS)
    assert "trigpoint_msgs/FaceSighting[] faces" in text
    assert "MSG: trigpoint_msgs/FaceSighting" in text
    assert "float32 sigma" in text


def sightings(**changes: object) -> Sightings:
    values: dict[str, object] = {
        "target": "t",
        "face": 0,
        "corners": np.arange(2, dtype=np.uint16),
        "pixels": np.zeros((2, 2), np.float32),
        "sigma": 1.0,
    }
    return Sightings(1, "c1/optical", 640, 480, (FaceSighting(**values | changes),))  # pyright: ignore[reportArgumentType]


def grid(values: np.ndarray, *, cell_m: float = 0.1) -> OccupancyGrid:
    return OccupancyGrid(1, "map", cell_m, Pose.planar(-1.0, 2.0, 0.0), values)


def test_a_grid_has_the_bytes_that_rosbags_gives_the_ros_message() -> None:
    types = get_typestore(Stores.ROS2_JAZZY).types
    stamp = types["builtin_interfaces/msg/Time"](sec=1, nanosec=5)
    position = types["geometry_msgs/msg/Point"](x=-1.0, y=2.0, z=0.0)
    level = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
    info = types["nav_msgs/msg/MapMetaData"](
        map_load_time=stamp,
        resolution=0.1,
        width=3,
        height=2,
        origin=types["geometry_msgs/msg/Pose"](position=position, orientation=level),
    )
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="map")
    data = np.array([-1, 0, 1, 2, 99, 100], np.int8)
    ros = types["nav_msgs/msg/OccupancyGrid"](header=header, info=info, data=data)
    ours = OccupancyGrid(1_000_000_005, "map", 0.1, Pose.planar(-1.0, 2.0, 0.0), data.reshape(2, 3))
    store = get_typestore(Stores.ROS2_JAZZY)
    assert encode(ours) == bytes(store.serialize_cdr(ros, messages.OCCUPANCY_GRID))


def odometry(pose: Pose) -> Odometry:
    return Odometry(1, "r1/odom", "r1/base", pose)


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (lambda: sightings(pixels=np.full((2, 2), np.nan, np.float32)), "not finite"),
        (lambda: sightings(sigma=0.0), "must lie between"),
        (lambda: sightings(sigma=float("nan")), "must lie between"),
        (lambda: sightings(corners=np.zeros(2, np.uint16)), "names a corner twice"),
        (lambda: sightings(corners=np.arange(3, dtype=np.uint16)), "3 corners but 4 pixel"),
        (
            lambda: sightings(corners=np.zeros(0, np.uint16), pixels=np.zeros((0, 2), np.float32)),
            "0 corners",
        ),
        (lambda: odometry(Pose(np.eye(3), np.array([np.inf, 0, 0]))), "a position holds"),
        (lambda: PoseEstimate(1, "map", Pose.identity(), np.full((6, 6), np.nan)), "covariance"),
        (lambda: Polygon(1, "map", np.full((3, 3), np.nan)), "a polygon holds"),
        (lambda: grid(np.full((2, 3), 101, np.int8)), "a value that is not from -1 to 100"),
        (lambda: grid(np.zeros((2, 3), np.int8), cell_m=np.nan), "has cells of nan m"),
    ],
)
def test_unsound_message_is_refused_on_arrival(make: Callable[[], Message], complaint: str) -> None:
    message = make()
    with pytest.raises(MessageError, match=complaint):
        decode(type_name(message), encode(message))


@pytest.mark.parametrize("level", [4, 127, 128, 200, 255])
def test_a_level_that_is_none_is_refused_and_said_as_the_octet_that_it_is(level: int) -> None:
    status = DiagnosticStatus(3, "edge/c1", "", "", {})
    payload = bytearray(encode(Diagnostics(0, (status,))))
    assert payload.count(3) == 1
    payload[payload.index(3)] = level
    with pytest.raises(MessageError, match=f"«edge/c1» has the level {level}; 3 is the highest"):
        decode(messages.DIAGNOSTICS, bytes(payload))


def test_orientation_that_is_no_rotation_is_refused() -> None:
    payload = bytearray(encode(PoseStamped(0, "map", Pose.identity())))
    payload[-8:] = np.float64(0.5).tobytes()  # w, the last number
    with pytest.raises(MessageError, match="no unit quaternion"):
        decode(messages.POSE_STAMPED, bytes(payload))


def test_stamp_before_1970_is_refused() -> None:
    with pytest.raises(MessageError, match="before 1970"):
        encode(PoseStamped(-1, "map", Pose.identity()))


@settings(max_examples=100)
@given(drawn_messages, st.integers(10**9, 2**32 - 1))
def test_a_stamp_whose_nanosec_is_a_second_or_more_is_refused_and_named(
    message: Message, part: int
) -> None:
    name, payload = type_name(message), bytearray(encode(message))
    at = 12 if name == messages.TRANSFORMS else 8  # each of these has a stamp of its own
    assume(not isinstance(message, messages.Transforms) or message.transforms)
    payload[at : at + 4] = part.to_bytes(4, "little")
    with pytest.raises(MessageError, match=f"nanosec is {part}, which is a second or more"):
        decode(name, bytes(payload))
    assert "nanosec" in fault_in(name, bytes(payload))


def test_our_own_definitions_keep_their_comments_and_their_hash() -> None:
    text = definition(messages.SIGHTINGS)
    assert "# stamp: middle of exposure" in text
    assert "MSG: trigpoint_msgs/FaceSighting\n# One detection" in text
    again = get_typestore(Stores.EMPTY)
    again.register(get_types_from_msg(text, messages.SIGHTINGS))
    assert again.hash_rihs01(messages.SIGHTINGS) == type_hash(messages.SIGHTINGS)
