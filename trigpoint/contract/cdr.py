"""Messages to and from ROS 2 CDR bytes.

`decode` checks its result: finite numbers, unit quaternions, as many pixels as corners.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from trigpoint.base.errors import MessageError
from trigpoint.contract import cdr_layout
from trigpoint.geometry import CameraModel, Pose

from .cdr_codecs import CODECS
from .cdr_ros import Builder, full_definition, stamp_of, store
from .cdr_writing import quickly_written
from .messages import (
    CAMERA_INFO,
    DIAGNOSTICS,
    ODOMETRY,
    PICTURE,
    POSE_ESTIMATE,
    POSE_STAMPED,
    RAW_IMAGE,
    SIGHTINGS,
    CameraInfo,
    Diagnostics,
    DiagnosticStatus,
    FaceSighting,
    Message,
    OccupancyGrid,
    Odometry,
    Picture,
    Polygon,
    PoseArray,
    PoseEstimate,
    PoseStamped,
    Sightings,
    Transform,
    Transforms,
)
from .picture_bytes import fault_in_compressed, fault_in_raw

_BY_CLASS = {codec.message: codec for codec in CODECS}
_BY_TYPE = {codec.type_name: codec for codec in CODECS}
LAYOUTS: dict[str, Callable[[bytes], Message | None]] = {
    ODOMETRY: cdr_layout.odometry,
    SIGHTINGS: cdr_layout.sightings,
    POSE_ESTIMATE: cdr_layout.pose_estimate,
    POSE_STAMPED: cdr_layout.pose_stamped,
    CAMERA_INFO: cdr_layout.camera_info,
    DIAGNOSTICS: cdr_layout.diagnostics,
}


_USUAL_MOST_BYTES = 1 << 20
_MOST_BYTES = {PICTURE: 16 << 20, ODOMETRY: 4 << 10, CAMERA_INFO: 64 << 10}
"""Longer payloads are refused unread."""


def encode(message: Message) -> bytes:
    """The CDR bytes of a message, with the encapsulation header."""
    quickly = quickly_written(message)
    return quickly if quickly is not None else encode_by_definition(message)


def encode_by_definition(message: Message) -> bytes:
    """Like `encode`, always by way of the type's definition."""
    codec = _BY_CLASS[type(message)]
    ros = codec.to_ros(Builder(), message)
    return bytes(store().serialize_cdr(ros, codec.type_name))


def decode(type_name: str, payload: bytes) -> Message:
    """Decode CDR bytes; raise MessageError if they are not a valid message of the type."""
    quickly = LAYOUTS.get(type_name)
    message = quickly(payload) if quickly else None
    return message if message is not None else decode_by_definition(type_name, payload)


def decode_by_definition(type_name: str, payload: bytes) -> Message:
    """Like `decode`, always by way of the type's definition; its errors say what is wrong."""
    codec = _BY_TYPE[type_name]
    cdr_layout.check_count("bytes", len(payload), _MOST_BYTES.get(type_name, _USUAL_MOST_BYTES))
    try:
        return codec.from_ros(store().deserialize_cdr(payload, type_name))
    except MessageError:
        raise
    except Exception as reason:  # noqa: BLE001 - rosbags raises whatever the bytes lead it to
        raise MessageError(
            f"{len(payload)} bytes are no {type_name} ({type(reason).__name__}: {reason})"
        ) from None


def fault_in(type_name: str, payload: bytes) -> str:
    """What hinders reading bytes as a message of the type, whatever it says; "" where nothing does,
    or it is a type that has no use here."""
    if type_name not in _BY_TYPE and type_name != RAW_IMAGE:
        return ""
    try:
        quickly = LAYOUTS.get(type_name)
        if quickly is not None and quickly(payload) is not None:
            return ""
        found: Any = store().deserialize_cdr(payload, type_name)
        for part in (found, *getattr(found, "transforms", ())):
            if hasattr(part, "header"):
                stamp_of(part.header)
    except MessageError as reason:
        return f"cannot be used: {reason}"
    except Exception:  # noqa: BLE001 - rosbags raises whatever the bytes lead it to
        return "cannot be decoded"
    if type_name == RAW_IMAGE:
        return fault_in_raw(found.data.size, found.width, found.height, found.encoding)
    return fault_in_compressed(bytes(found.data), found.format) if type_name == PICTURE else ""


def type_name(message: Message) -> str:
    """The ROS name of a message's type."""
    return _BY_CLASS[type(message)].type_name


def definition(type_name: str) -> str:
    """The full `ros2msg` definition of a type, including the types that it uses."""
    return full_definition(type_name)


def type_hash(type_name: str) -> str:
    """The type's RIHS01 hash, as ROS 2 computes it; "" of a type that is not known here."""
    return store().hash_rihs01(type_name) if type_name in store().types else ""


def warm_up() -> None:
    """Build every type's code now (2 to 15 ms each), so that no first message is delayed."""
    for codec in CODECS:
        definition(codec.type_name)
    pose = Pose.identity()
    camera = CameraModel(1, 1, 1.0, 1.0, 0.0, 0.0)
    face = FaceSighting("", 0, np.zeros(1, np.uint16), np.zeros((1, 2), np.float32), 1.0)
    status = DiagnosticStatus(0, "", "", "", {"a": "b"})
    for message in (
        Sightings(0, "", 1, 1, (face,)),
        Odometry(0, "", "", pose),
        PoseEstimate(0, "", pose, np.eye(6)),
        PoseStamped(0, "", pose),
        PoseArray(0, "", Pose.stack([pose])),
        Picture(0, "", "jpeg", b"\0"),
        CameraInfo(0, "", camera),
        Transforms((Transform(0, "", "", pose),)),
        Polygon(0, "", np.zeros((1, 3))),
        OccupancyGrid(0, "", 0.1, pose, np.zeros((1, 1), np.int8)),
        Diagnostics(0, (status,)),
    ):
        decode(type_name(message), encode(message))
