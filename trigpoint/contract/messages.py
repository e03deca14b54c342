"""The messages of the bus as frozen structs; `cdr` turns them into bytes and back.

Stamps are integer nanoseconds of Unix time, on the sender's clock.
"""

from enum import StrEnum
from typing import TypeVar

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array

SIGHTINGS = "trigpoint_msgs/msg/Sightings"
ODOMETRY = "nav_msgs/msg/Odometry"
POSE_ESTIMATE = "geometry_msgs/msg/PoseWithCovarianceStamped"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
POSE_ARRAY = "geometry_msgs/msg/PoseArray"
PICTURE = "sensor_msgs/msg/CompressedImage"
RAW_IMAGE = "sensor_msgs/msg/Image"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
POLYGON = "geometry_msgs/msg/PolygonStamped"
OCCUPANCY_GRID = "nav_msgs/msg/OccupancyGrid"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"


class FaceSighting(Struct, frozen=True):
    """One face found in one picture.

    `corners`: (n,) uint16 ids; `pixels`: (n, 2) float32, raw picture coordinates; `sigma`: standard
    deviation of one coordinate, pixels. `face` is -1 if the pattern does not identify the face.
    """

    target: str
    face: int
    corners: np.ndarray
    pixels: np.ndarray
    sigma: float


class Mended(StrEnum):
    """What a message lacked, and what was taken in its place, since its meaning is plain."""

    UNSTAMPED = (
        "without a stamp (0), taken at the time of recording or arrival: fill in header.stamp"
    )
    NOT_NORMALISED = "with a quaternion whose length is not 1, normalised"
    NO_TWIST = "with a twist that is not finite, which nothing needs"


class Sightings(Struct, frozen=True):
    """All faces found in one picture; stamp: middle of exposure; `frame_id`: <camera>/optical.
    `mended`: what it lacked as it was read."""

    stamp_ns: int
    frame_id: str
    width: int
    height: int
    faces: tuple[FaceSighting, ...]
    mended: tuple[Mended, ...] = ()


class Odometry(Struct, frozen=True):
    """Pose of `child_frame_id` (<robot>/base) in `frame_id` (<robot>/odom), and the twist.
    `mended`: what it lacked as it was read."""

    stamp_ns: int
    frame_id: str
    child_frame_id: str
    pose: Pose
    linear: Array = field(default_factory=lambda: np.zeros(3))
    angular: Array = field(default_factory=lambda: np.zeros(3))
    mended: tuple[Mended, ...] = ()


_Stamped = TypeVar("_Stamped", bound=Sightings | Odometry)


def stamped(message: _Stamped, recorded_ns: int) -> _Stamped:
    """The message; one without a stamp is taken at the time of its recording, or arrival."""
    if message.stamp_ns:
        return message
    return replace(message, stamp_ns=recorded_ns, mended=(*message.mended, Mended.UNSTAMPED))


class PoseEstimate(Struct, frozen=True):
    """A pose in `frame_id` with the contract's covariance, (6, 6)."""

    stamp_ns: int
    frame_id: str
    pose: Pose
    covariance: Array


class PoseStamped(Struct, frozen=True):
    """A pose in `frame_id`."""

    stamp_ns: int
    frame_id: str
    pose: Pose


class PoseArray(Struct, frozen=True):
    """Many poses in `frame_id`; `poses` has one leading dimension."""

    stamp_ns: int
    frame_id: str
    poses: Pose


class Picture(Struct, frozen=True):
    """A compressed picture; `format` is "jpeg"."""

    stamp_ns: int
    frame_id: str
    format: str
    data: bytes


class CameraInfo(Struct, frozen=True):
    """A camera's intrinsics."""

    stamp_ns: int
    frame_id: str
    camera: CameraModel


class Transform(Struct, frozen=True):
    """parent_from_child at a time."""

    stamp_ns: int
    parent: str
    child: str
    pose: Pose


class Transforms(Struct, frozen=True):
    """The message on tf."""

    transforms: tuple[Transform, ...]


class Polygon(Struct, frozen=True):
    """A polygon in `frame_id`; `points`: (n, 3), metres."""

    stamp_ns: int
    frame_id: str
    points: Array


class OccupancyGrid(Struct, frozen=True):
    """A grid of cells in `frame_id`: `values` (rows, columns) int8, 0 to 100, -1 unknown, row by
    row from the corner at `origin`, which the rows run along x from; a cell's side `cell_m`."""

    stamp_ns: int
    frame_id: str
    cell_m: float
    origin: Pose
    values: np.ndarray


class DiagnosticStatus(Struct, frozen=True):
    """One component's state; `level` is 0 OK, 1 WARN, 2 ERROR, 3 STALE."""

    level: int
    name: str
    message: str
    hardware_id: str
    values: dict[str, str]


class Diagnostics(Struct, frozen=True):
    """A node's state, sent once a second."""

    stamp_ns: int
    statuses: tuple[DiagnosticStatus, ...]


Message = (
    Sightings
    | Odometry
    | PoseEstimate
    | PoseStamped
    | PoseArray
    | Picture
    | CameraInfo
    | Transforms
    | Polygon
    | OccupancyGrid
    | Diagnostics
)
