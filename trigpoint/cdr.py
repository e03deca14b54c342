"""ROS 2 CDR bytes of the messages; the one place that knows rosbags.

What `decode` returns is checked: finite numbers, unit quaternions, as many pixels as corners.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from . import cdr_layout
from .cdr_layout import FURTHEST_PX, LEAST_SIGMA_PX, MOST_SIGMA_PX, UNIT_TOLERANCE
from .errors import MessageError
from .geometry import CameraModel, Pose
from .geometry.camera import LensModel
from .geometry.rotation import Array
from .messages import (
    CAMERA_INFO,
    DIAGNOSTICS,
    ODOMETRY,
    PICTURE,
    POLYGON,
    POSE_ARRAY,
    POSE_ESTIMATE,
    POSE_STAMPED,
    SIGHTINGS,
    TRANSFORMS,
    CameraInfo,
    Diagnostics,
    DiagnosticStatus,
    FaceSighting,
    Message,
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

_SIGHTINGS_DEFINITION = """std_msgs/Header header
uint32 width
uint32 height
trigpoint_msgs/FaceSighting[] faces
"""

_FACE_SIGHTING_DEFINITION = """string target
int32 face
uint16[] corners
float32[] pixels
float32 sigma
"""


def encode(message: Message) -> bytes:
    """The CDR bytes of a message, with the encapsulation header."""
    codec = _CODECS_BY_CLASS[type(message)]
    ros = codec.to_ros(_Builder(), message)
    return bytes(_store().serialize_cdr(ros, codec.type_name))


def decode(type_name: str, payload: bytes) -> Message:
    """The message in CDR bytes; raise MessageError where they are no sound message of the type."""
    quickly = _LAYOUTS.get(type_name)
    message = quickly(payload) if quickly else None
    return message if message is not None else decode_by_definition(type_name, payload)


def decode_by_definition(type_name: str, payload: bytes) -> Message:
    """`decode` by the type's definition alone; it says what is wrong where something is."""
    codec = _CODECS_BY_TYPE[type_name]
    try:
        return codec.from_ros(_store().deserialize_cdr(payload, type_name))
    except MessageError:
        raise
    except Exception as reason:  # noqa: BLE001 - rosbags raises whatever the bytes lead it to
        raise MessageError(
            f"{len(payload)} bytes are no {type_name} ({type(reason).__name__}: {reason})"
        ) from None


def type_name(message: Message) -> str:
    """The ROS name of a message's type."""
    return _CODECS_BY_CLASS[type(message)].type_name


def definition(type_name: str) -> str:
    """The full `ros2msg` definition of a type, with the types that it uses."""
    return _store().generate_msgdef(type_name, ros_version=2)[0]


def type_hash(type_name: str) -> str:
    """The type's RIHS01 hash, as ROS 2 computes it."""
    return _store().hash_rihs01(type_name)


def warm_up() -> None:
    """Build every type's code now (2 to 15 ms each), so that no first message is late."""
    for codec in _CODECS:
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
        Diagnostics(0, (status,)),
    ):
        decode(type_name(message), encode(message))


@cache
def _store() -> Typestore:
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(_FACE_SIGHTING_DEFINITION, "trigpoint_msgs/msg/FaceSighting"))
    store.register(get_types_from_msg(_SIGHTINGS_DEFINITION, SIGHTINGS))
    return store


class _Builder:
    """Builds rosbags' objects by short type names."""

    def __call__(self, ros_type: str, /, **fields: Any) -> Any:
        package, short = ros_type.split("/")
        return _store().types[f"{package}/msg/{short}"](**fields)

    def header(self, stamp_ns: int, frame_id: str) -> Any:
        if stamp_ns < 0:
            raise MessageError(f"a stamp of {stamp_ns} ns lies before 1970; check the clock")
        seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
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


def _stamp(header: Any) -> int:
    return header.stamp.sec * 1_000_000_000 + header.stamp.nanosec


def _finite(values: Any, what: str) -> Array:
    array = np.asarray(values, dtype=float)
    if not np.all(np.isfinite(array)):
        raise MessageError(f"{what} holds a number that is not finite")
    return array


def _xyz(vector: Any, what: str) -> Array:
    return _finite([vector.x, vector.y, vector.z], what)


def _pose(pose: Any) -> Pose:
    q = pose.orientation
    quaternion = _finite([q.x, q.y, q.z, q.w], "an orientation")
    if abs(np.linalg.norm(quaternion) - 1) > UNIT_TOLERANCE:
        raise MessageError("an orientation is no unit quaternion")
    return Pose.from_quaternion(_xyz(pose.position, "a position"), quaternion)


@dataclass(frozen=True, slots=True)
class _Codec:
    message: type
    type_name: str
    to_ros: Callable[[_Builder, Any], Any]
    from_ros: Callable[[Any], Any]


def _sightings_to_ros(ros: _Builder, m: Sightings) -> Any:
    faces = [
        ros(
            "trigpoint_msgs/FaceSighting",
            target=face.target,
            face=face.face,
            corners=np.ascontiguousarray(face.corners, np.uint16),
            pixels=np.ascontiguousarray(face.pixels, np.float32).reshape(-1),
            sigma=face.sigma,
        )
        for face in m.faces
    ]
    header = ros.header(m.stamp_ns, m.frame_id)
    return ros(
        "trigpoint_msgs/Sightings",
        header=header,
        width=m.width,
        height=m.height,
        faces=faces,
    )


def _sightings_from_ros(ros: Any) -> Sightings:
    faces = tuple(_face_from_ros(face) for face in ros.faces)
    return Sightings(_stamp(ros.header), ros.header.frame_id, ros.width, ros.height, faces)


def _face_from_ros(face: Any) -> FaceSighting:
    if len(face.pixels) != 2 * len(face.corners) or len(face.corners) == 0:
        raise MessageError(
            f"a face has {len(face.corners)} corners but {len(face.pixels)} pixel coordinates"
        )
    if len(set(face.corners.tolist())) != len(face.corners):
        raise MessageError("a face names a corner twice")
    _finite(face.pixels, "a face")
    if not LEAST_SIGMA_PX <= face.sigma <= MOST_SIGMA_PX:
        raise MessageError(
            f"a face has a sigma of {face.sigma} px; "
            f"it must lie between {LEAST_SIGMA_PX} and {MOST_SIGMA_PX}"
        )
    if np.abs(face.pixels).max() > FURTHEST_PX:
        raise MessageError(f"a face has a corner beyond {FURTHEST_PX} pixels")
    pixels = face.pixels.reshape(-1, 2)
    return FaceSighting(face.target, face.face, face.corners, pixels, float(face.sigma))


def _odometry_to_ros(ros: _Builder, m: Odometry) -> Any:
    none = np.zeros(36)
    twist = ros(
        "geometry_msgs/Twist",
        linear=ros.vector(m.linear),
        angular=ros.vector(m.angular),
    )
    return ros(
        "nav_msgs/Odometry",
        header=ros.header(m.stamp_ns, m.frame_id),
        child_frame_id=m.child_frame_id,
        pose=ros("geometry_msgs/PoseWithCovariance", pose=ros.pose(m.pose), covariance=none),
        twist=ros("geometry_msgs/TwistWithCovariance", twist=twist, covariance=none),
    )


def _odometry_from_ros(ros: Any) -> Odometry:
    return Odometry(
        _stamp(ros.header),
        ros.header.frame_id,
        ros.child_frame_id,
        _pose(ros.pose.pose),
        _xyz(ros.twist.twist.linear, "a twist"),
        _xyz(ros.twist.twist.angular, "a twist"),
    )


def _estimate_to_ros(ros: _Builder, m: PoseEstimate) -> Any:
    covariance = np.ascontiguousarray(m.covariance, dtype=float).reshape(-1)
    return ros(
        "geometry_msgs/PoseWithCovarianceStamped",
        header=ros.header(m.stamp_ns, m.frame_id),
        pose=ros(
            "geometry_msgs/PoseWithCovariance",
            pose=ros.pose(m.pose),
            covariance=covariance,
        ),
    )


def _estimate_from_ros(ros: Any) -> PoseEstimate:
    covariance = _finite(ros.pose.covariance, "a covariance").reshape(6, 6)
    return PoseEstimate(_stamp(ros.header), ros.header.frame_id, _pose(ros.pose.pose), covariance)


def _pose_stamped_to_ros(ros: _Builder, m: PoseStamped) -> Any:
    header = ros.header(m.stamp_ns, m.frame_id)
    return ros("geometry_msgs/PoseStamped", header=header, pose=ros.pose(m.pose))


def _pose_stamped_from_ros(ros: Any) -> PoseStamped:
    return PoseStamped(_stamp(ros.header), ros.header.frame_id, _pose(ros.pose))


def _pose_array_to_ros(ros: _Builder, m: PoseArray) -> Any:
    poses = [ros.pose(m.poses[i]) for i in range(len(m.poses))]
    return ros(
        "geometry_msgs/PoseArray",
        header=ros.header(m.stamp_ns, m.frame_id),
        poses=poses,
    )


def _pose_array_from_ros(ros: Any) -> PoseArray:
    poses = Pose.stack([_pose(pose) for pose in ros.poses])
    return PoseArray(_stamp(ros.header), ros.header.frame_id, poses)


def _picture_to_ros(ros: _Builder, m: Picture) -> Any:
    return ros(
        "sensor_msgs/CompressedImage",
        header=ros.header(m.stamp_ns, m.frame_id),
        format=m.format,
        data=np.frombuffer(m.data, np.uint8),
    )


def _picture_from_ros(ros: Any) -> Picture:
    return Picture(_stamp(ros.header), ros.header.frame_id, ros.format, ros.data.tobytes())


def _camera_info_to_ros(ros: _Builder, m: CameraInfo) -> Any:
    camera = m.camera
    projection = np.zeros((3, 4))
    projection[:, :3] = camera.matrix
    return ros(
        "sensor_msgs/CameraInfo",
        header=ros.header(m.stamp_ns, m.frame_id),
        height=camera.height,
        width=camera.width,
        distortion_model=camera.model.value,
        d=np.array(camera.distortion),
        k=camera.matrix.reshape(-1),
        r=np.eye(3).reshape(-1),
        p=projection.reshape(-1),
        binning_x=0,
        binning_y=0,
        roi=ros(
            "sensor_msgs/RegionOfInterest",
            x_offset=0,
            y_offset=0,
            height=0,
            width=0,
            do_rectify=False,
        ),
    )


def _camera_info_from_ros(ros: Any) -> CameraInfo:
    k = _finite(ros.k, "a camera matrix")
    distortion = tuple(_finite(ros.d, "a distortion").tolist())
    try:
        camera = CameraModel(
            ros.width,
            ros.height,
            float(k[0]),
            float(k[4]),
            float(k[2]),
            float(k[5]),
            distortion,
            LensModel(ros.distortion_model),
        )
    except ValueError as reason:
        raise MessageError(f"the camera_info of {ros.header.frame_id}: {reason}") from None
    return CameraInfo(_stamp(ros.header), ros.header.frame_id, camera)


def _transforms_to_ros(ros: _Builder, m: Transforms) -> Any:
    return ros(
        "tf2_msgs/TFMessage",
        transforms=[_transform_to_ros(ros, t) for t in m.transforms],
    )


def _transform_to_ros(ros: _Builder, t: Transform) -> Any:
    return ros(
        "geometry_msgs/TransformStamped",
        header=ros.header(t.stamp_ns, t.parent),
        child_frame_id=t.child,
        transform=ros(
            "geometry_msgs/Transform",
            translation=ros.vector(t.pose.translation),
            rotation=ros.quaternion(t.pose),
        ),
    )


def _transforms_from_ros(ros: Any) -> Transforms:
    return Transforms(tuple(_transform_from_ros(t) for t in ros.transforms))


def _transform_from_ros(t: Any) -> Transform:
    both = t.transform
    pose = _pose(SimpleNamespace(position=both.translation, orientation=both.rotation))
    return Transform(_stamp(t.header), t.header.frame_id, t.child_frame_id, pose)


def _polygon_to_ros(ros: _Builder, m: Polygon) -> Any:
    points = [
        ros("geometry_msgs/Point32", x=float(x), y=float(y), z=float(z)) for x, y, z in m.points
    ]
    return ros(
        "geometry_msgs/PolygonStamped",
        header=ros.header(m.stamp_ns, m.frame_id),
        polygon=ros("geometry_msgs/Polygon", points=points),
    )


def _polygon_from_ros(ros: Any) -> Polygon:
    points = [[point.x, point.y, point.z] for point in ros.polygon.points]
    array = _finite(points, "a polygon").reshape(-1, 3)
    return Polygon(_stamp(ros.header), ros.header.frame_id, array)


def _diagnostics_to_ros(ros: _Builder, m: Diagnostics) -> Any:
    statuses = [
        ros(
            "diagnostic_msgs/DiagnosticStatus",
            level=status.level,
            name=status.name,
            message=status.message,
            hardware_id=status.hardware_id,
            values=[
                ros("diagnostic_msgs/KeyValue", key=key, value=value)
                for key, value in status.values.items()
            ],
        )
        for status in m.statuses
    ]
    return ros(
        "diagnostic_msgs/DiagnosticArray",
        header=ros.header(m.stamp_ns, ""),
        status=statuses,
    )


def _diagnostics_from_ros(ros: Any) -> Diagnostics:
    statuses = tuple(
        DiagnosticStatus(
            status.level,
            status.name,
            status.message,
            status.hardware_id,
            {pair.key: pair.value for pair in status.values},
        )
        for status in ros.status
    )
    return Diagnostics(_stamp(ros.header), statuses)


_CODECS = (
    _Codec(Sightings, SIGHTINGS, _sightings_to_ros, _sightings_from_ros),
    _Codec(Odometry, ODOMETRY, _odometry_to_ros, _odometry_from_ros),
    _Codec(PoseEstimate, POSE_ESTIMATE, _estimate_to_ros, _estimate_from_ros),
    _Codec(PoseStamped, POSE_STAMPED, _pose_stamped_to_ros, _pose_stamped_from_ros),
    _Codec(PoseArray, POSE_ARRAY, _pose_array_to_ros, _pose_array_from_ros),
    _Codec(Picture, PICTURE, _picture_to_ros, _picture_from_ros),
    _Codec(CameraInfo, CAMERA_INFO, _camera_info_to_ros, _camera_info_from_ros),
    _Codec(Transforms, TRANSFORMS, _transforms_to_ros, _transforms_from_ros),
    _Codec(Polygon, POLYGON, _polygon_to_ros, _polygon_from_ros),
    _Codec(Diagnostics, DIAGNOSTICS, _diagnostics_to_ros, _diagnostics_from_ros),
)
_CODECS_BY_CLASS = {codec.message: codec for codec in _CODECS}
_CODECS_BY_TYPE = {codec.type_name: codec for codec in _CODECS}
_LAYOUTS: dict[str, Callable[[bytes], Message | None]] = {
    ODOMETRY: cdr_layout.odometry,
    SIGHTINGS: cdr_layout.sightings,
}
