"""Every key of the contract: its expression, type, delivery, and whether it is recorded."""

from enum import Enum
from functools import lru_cache

from msgspec import Struct

from trigpoint.contract import messages

UNTYPED = ("", "zenoh/bytes", "application/cdr", "application/octet-stream")
"""Encodings that name no type."""


class Delivery(Enum):
    """How a key's samples are delivered; `trigpoint.zenoh` maps each to Zenoh settings."""

    NEWEST = "best effort, newest wins, low priority"
    RECOVERED = "reliable, recovered after a break"
    LAST_VALUE = "reliable, last value kept for late joiners"
    RELIABLE = "reliable"
    URGENT = "reliable, highest priority, express"
    BEST_EFFORT = "best effort"

    @property
    def is_reliable(self) -> bool:
        """Whether every sample must arrive."""
        return self not in (Delivery.NEWEST, Delivery.BEST_EFFORT)


class Topic(Struct, frozen=True):
    """One row: `path` below the site with `{id}` for the camera or robot.

    `queue`: how many samples a subscriber holds; when full, the oldest is dropped and counted.
    `cache`: how many a publisher keeps for subscribers that come late or were disconnected.
    """

    name: str
    path: str
    type_name: str
    delivery: Delivery
    queue: int
    cache: int = 0
    recorded: bool = True

    @property
    def encoding(self) -> str:
        """The sample's encoding, with the type name as its schema."""
        return f"application/cdr;{self.type_name}"

    def may_be(self, encoding: str) -> bool:
        """Whether a sample with this encoding may have the topic's type: true if it names that type
        or none. The key fixes the type (a ROS 2 bridge sets no encoding), and decoding checks
        it."""
        return encoding in (self.encoding, *UNTYPED)

    def key(self, site: str, node: str = "") -> str:
        """The key of one camera or robot."""
        return f"{site}/{self.path.format(id=node)}"

    def expression(self, site: str) -> str:
        """The key expression of all cameras or robots."""
        return f"{site}/{self.path.format(id='*')}"

    def match(self, key: str) -> tuple[str, str] | None:
        """(site, camera or robot) of a key of this row, else None; "" if the row has no id."""
        site, _, rest = key.partition("/")
        parts, pattern = rest.split("/"), self.path.split("/")
        if not site or len(parts) != len(pattern):
            return None
        node = ""
        for part, expected in zip(parts, pattern, strict=True):
            if expected == "{id}":
                node = part
            elif part != expected:
                return None
        return site, node


IMAGE = Topic("image", "camera/{id}/image/compressed", messages.PICTURE, Delivery.NEWEST, queue=4)
CAMERA_INFO = Topic(
    "camera_info",
    "camera/{id}/camera_info",
    messages.CAMERA_INFO,
    Delivery.LAST_VALUE,
    64,
    cache=1,
)
SIGHTINGS = Topic(
    "sightings",
    "camera/{id}/sightings",
    messages.SIGHTINGS,
    Delivery.RECOVERED,
    4096,
    cache=1024,
)
CAMERA_POSE = Topic(
    "camera_pose",
    "camera/{id}/pose",
    messages.POSE_ESTIMATE,
    Delivery.LAST_VALUE,
    256,
    cache=1,
)
ODOMETRY = Topic("odom", "robot/{id}/odom", messages.ODOMETRY, Delivery.RECOVERED, 8192, cache=1024)
ROBOT_POSE = Topic("robot_pose", "robot/{id}/pose", messages.POSE_ESTIMATE, Delivery.RELIABLE, 1024)
CORRECTION = Topic(
    "correction",
    "robot/{id}/correction",
    messages.POSE_ESTIMATE,
    Delivery.URGENT,
    queue=64,
)
CORRECTED = Topic(
    "corrected", "robot/{id}/corrected", messages.POSE_ESTIMATE, Delivery.RELIABLE, queue=256
)
"""Pose of a robot that takes no corrections, from its bridge: checked and fused, per reading."""
ROBOT_TF = Topic("robot_tf", "robot/{id}/tf", messages.TRANSFORMS, Delivery.RELIABLE, queue=256)
"""The same as transforms: map → odom, and odom → base if the bridge makes the odometry."""
SUGGESTION = Topic(
    "suggestion",
    "robot/{id}/suggestion",
    messages.POSE_STAMPED,
    Delivery.BEST_EFFORT,
    queue=16,
)
PARTICLES = Topic(
    "particles",
    "robot/{id}/particles",
    messages.POSE_ARRAY,
    Delivery.BEST_EFFORT,
    queue=4,
)
TF = Topic("tf", "tf", messages.TRANSFORMS, Delivery.RELIABLE, queue=1024)
TF_STATIC = Topic(
    "tf_static", "tf_static", messages.TRANSFORMS, Delivery.LAST_VALUE, queue=256, cache=1
)
"""Every located camera, where ROS tools expect static transforms; also on `tf`."""
COVERAGE = Topic(
    "coverage",
    "coverage/{id}",
    messages.POLYGON,
    Delivery.LAST_VALUE,
    queue=256,
    cache=1,
)
COVERAGE_GRID = Topic(
    "coverage_grid",
    "coverage",
    messages.OCCUPANCY_GRID,
    Delivery.LAST_VALUE,
    queue=4,
    cache=1,
)
"""How well a robot is corrected where, for planners."""
DIAGNOSTICS = Topic(
    "diagnostics", "diagnostics", messages.DIAGNOSTICS, Delivery.BEST_EFFORT, queue=256
)

TOPICS = (
    IMAGE,
    CAMERA_INFO,
    SIGHTINGS,
    CAMERA_POSE,
    ODOMETRY,
    ROBOT_POSE,
    CORRECTION,
    CORRECTED,
    ROBOT_TF,
    SUGGESTION,
    PARTICLES,
    TF,
    TF_STATIC,
    COVERAGE,
    COVERAGE_GRID,
    DIAGNOSTICS,
)


@lru_cache(maxsize=4096)
def topic_of(key: str) -> Topic | None:
    """The row of a key, or None if the contract has none."""
    return next((topic for topic in TOPICS if topic.match(key)), None)


@lru_cache(maxsize=4096)
def node_of(key: str) -> str:
    """The camera or robot named by a key, "" if none."""
    topic = topic_of(key)
    match = topic.match(key) if topic else None
    return match[1] if match else ""


def alive_key(site: str, kind: str, node: str) -> str:
    """The liveliness token of a node."""
    return f"{site}/alive/{kind}/{node}"


def sent_key(site: str, session: str) -> str:
    """A sending session's queryable: its answer arrives after everything it sent before."""
    return f"{site}/sent/{session}"


def command_key(site: str, path: str) -> str:
    """The queryable of a command: `camera/c1/snapshot`, `fusion/network`, `clock` …"""
    return f"{site}/{path}"


@lru_cache(4096)
def key_matches(expression: str, key: str) -> bool:
    """Whether a key belongs to a key expression: `*` is one chunk, `**` any number of them."""
    return _chunks_match(expression.split("/"), key.split("/"))


def _chunks_match(expression: list[str], key: list[str]) -> bool:
    if not expression:
        return not key
    if expression[0] == "**":
        return any(_chunks_match(expression[1:], key[i:]) for i in range(len(key) + 1))
    if not key or expression[0] not in ("*", key[0]):
        return False
    return _chunks_match(expression[1:], key[1:])
