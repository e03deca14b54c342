"""ROS 2 messages as rosbags' objects: their types, how to build them, and how to read and check
their common parts. In the shared package, only this module imports rosbags.
"""

import math
from collections.abc import Mapping
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from trigpoint.base.clock import NANOSECONDS
from trigpoint.base.errors import MessageError
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from .cdr_layout import UNIT_TOLERANCE
from .messages import SIGHTINGS

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

_SIGHTINGS_DEFINITION = """# The faces found in one image; empty when none was found.
std_msgs/Header header          # stamp: middle of exposure; frame_id: <camera>/optical
uint32 width
uint32 height
trigpoint_msgs/FaceSighting[] faces
"""

_FACE_SIGHTING_DEFINITION = """# One detection of one face of a target in one image.
string target                   # its name; empty when several robots carry the same pattern
int32 face                      # id in the target file; -1 when the pattern does not say which
uint16[] corners                # corner ids, only those seen
float32[] pixels                # u0 v0 u1 v1 ..., raw (distorted) image coordinates, same order
float32 sigma                   # standard deviation of a coordinate, pixels
"""
_COMMENTED = {
    SIGHTINGS: _SIGHTINGS_DEFINITION,
    "trigpoint_msgs/FaceSighting": _FACE_SIGHTING_DEFINITION,
}
_SEPARATOR = "=" * 80 + "\n"
# Below it a quaternion is nothing but rounding, above its inverse it overflows.
_LEAST_LENGTH = 1e-6


@cache
def store() -> "Typestore":
    """ROS 2's types and ours; made once, where a message needs it: rosbags takes long to import."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    types = get_typestore(Stores.ROS2_JAZZY)
    types.register(get_types_from_msg(_FACE_SIGHTING_DEFINITION, "trigpoint_msgs/msg/FaceSighting"))
    types.register(get_types_from_msg(_SIGHTINGS_DEFINITION, SIGHTINGS))
    return types


class Builder:
    """Builds rosbags' objects by short type names (`std_msgs/Header`)."""

    def __call__(self, ros_type: str, /, **fields: Any) -> Any:
        package, short = ros_type.split("/")
        return store().types[f"{package}/msg/{short}"](**fields)

    def header(self, stamp_ns: int, frame_id: str) -> Any:
        if stamp_ns < 0:
            raise MessageError(f"a stamp of {stamp_ns} ns lies before 1970; check the clock")
        seconds, nanoseconds = divmod(stamp_ns, NANOSECONDS)
        time = self("builtin_interfaces/Time", sec=seconds, nanosec=nanoseconds)
        return self("std_msgs/Header", stamp=time, frame_id=frame_id)

    def vector(self, values: Array) -> Any:
        x, y, z = (float(value) for value in values)
        return self("geometry_msgs/Vector3", x=x, y=y, z=z)

    def point(self, values: Array) -> Any:
        x, y, z = (float(value) for value in values)
        return self("geometry_msgs/Point", x=x, y=y, z=z)

    def quaternion(self, pose: Pose) -> Any:
        x, y, z, w = (float(value) for value in pose.quaternion)
        return self("geometry_msgs/Quaternion", x=x, y=y, z=z, w=w)

    def pose(self, pose: Pose) -> Any:
        return self(
            "geometry_msgs/Pose",
            position=self.point(pose.translation),
            orientation=self.quaternion(pose),
        )


def stamp_of(header: Any) -> int:
    """A header's stamp, nanoseconds; raise MessageError if its nanosec is a second or more: what
    was meant is not known."""
    seconds, part = header.stamp.sec, header.stamp.nanosec
    if part >= NANOSECONDS:
        raise MessageError(f"a stamp's nanosec is {part}, which is a second or more")
    return seconds * NANOSECONDS + part


def finite(values: Any, what: str) -> Array:
    """Numbers as a float array; raise a MessageError that names them if one is not finite."""
    with np.errstate(invalid="ignore"):  # non-numbers are refused below
        array = np.asarray(values, dtype=float)
    if not np.all(np.isfinite(array)):
        raise MessageError(f"{what} holds a number that is not finite")
    return array


def xyz_of(vector: Any, what: str) -> Array:
    """The three coordinates of a point or vector; raises as `finite`."""
    return finite([vector.x, vector.y, vector.z], what)


def pose_of(pose: Any) -> Pose:
    """A pose; raise MessageError if its orientation is not a rotation or a number not finite."""
    found, length = normalised_pose_of(pose)
    if abs(length - 1) > UNIT_TOLERANCE:
        raise MessageError("an orientation is no unit quaternion")
    return found


def normalised_pose_of(pose: Any) -> tuple[Pose, float]:
    """A pose, and the length that its quaternion had; raise MessageError if that is 0, or a number
    not finite."""
    q = pose.orientation
    quaternion = finite([q.x, q.y, q.z, q.w], "an orientation")
    length = math.hypot(*quaternion)
    if not _LEAST_LENGTH < length < 1 / _LEAST_LENGTH:
        raise MessageError(f"an orientation is a quaternion of length {length:g}, no rotation")
    return Pose.from_quaternion(xyz_of(pose.position, "a position"), quaternion), length


def register(definitions: Mapping[str, str]) -> None:
    """Register further types by their definitions; those already known are kept."""
    from rosbags.typesys import get_types_from_msg

    types = store()
    for name, text in definitions.items():
        if name not in types.types:
            types.register(get_types_from_msg(text, name))


def full_definition(type_name: str) -> str:
    """A type's `ros2msg` definition including the types that it uses; ours with comments."""
    first, *others = store().generate_msgdef(type_name, ros_version=2)[0].split(_SEPARATOR)
    parts = [_COMMENTED.get(type_name, first)]
    for other in others:
        title = other.partition("\n")[0]
        text = _COMMENTED.get(title.removeprefix("MSG: "))
        parts.append(f"{title}\n{text}" if text else other)
    return _SEPARATOR.join(parts)
