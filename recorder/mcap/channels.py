"""What a recording's channels hold besides messages: delivery, and samples' attachments."""

import struct

from trigpoint.contract.topics import Delivery, Topic

CHANNELS = "trigpoint.channels"
"""Metadata that repeat a file's channel definitions in case the records themselves are damaged:
number -> JSON of topic and type."""
ATTACHED = "std_msgs/msg/UInt8MultiArray"
"""The type of the second channel that holds the attachments of a key's samples: an MCAP message has
no place for them. It is one of ROS's own types, so that every ROS tool decodes it."""
_SUFFIX = "/attachment"
# CDR, little-endian: no dimensions, offset 0; then the number of bytes.
_HEAD = struct.Struct("<4sIII")
_ENCAPSULATION = b"\x00\x01\x00\x00"

_INFINITE = "{sec: 9223372036, nsec: 854775807}"


def attached_topic(key: str) -> str:
    """The key under which the attachments of a key's samples are recorded."""
    return key + _SUFFIX


def attached_to(key: str) -> str:
    """The key whose attachments these are, "" if it is not a key of attachments."""
    return key.removesuffix(_SUFFIX) if key.endswith(_SUFFIX) else ""


def attached(attachment: bytes) -> bytes:
    """The payload that holds an attachment."""
    return _HEAD.pack(_ENCAPSULATION, 0, 0, len(attachment)) + attachment


def attachment_in(payload: bytes) -> bytes:
    """The attachment in a payload, b"" if it is not one."""
    if len(payload) < _HEAD.size:
        return b""
    *_, length = _HEAD.unpack_from(payload)
    return payload[_HEAD.size : _HEAD.size + length]


def quality_of_service(topic: Topic) -> str:
    """The topic's delivery as rosbag2's YAML (Jazzy writes the policies as words)."""
    keeps = topic.delivery is Delivery.LAST_VALUE
    return (
        "- history: keep_last\n"
        f"  depth: {max(1, topic.cache)}\n"
        f"  reliability: {'reliable' if topic.delivery.is_reliable else 'best_effort'}\n"
        f"  durability: {'transient_local' if keeps else 'volatile'}\n"
        f"  deadline: {_INFINITE}\n"
        f"  lifespan: {_INFINITE}\n"
        "  liveliness: automatic\n"
        f"  liveliness_lease_duration: {_INFINITE}\n"
        "  avoid_ros_namespace_conventions: false\n"
    )
