"""A pair of functions per message type: our message to rosbags' object and back, checked."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
from msgspec import Struct

from trigpoint.base.errors import MessageError
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.camera import LensModel

from .cdr_layout import (
    FURTHEST_PX,
    LEAST_SIGMA_PX,
    MOST_CORNERS,
    MOST_FACES,
    MOST_LEVEL,
    MOST_SIGMA_PX,
    MOST_TEXT_BYTES,
    UNIT_TOLERANCE,
    check_count,
)
from .cdr_ros import Builder, finite, normalised_pose_of, pose_of, stamp_of
from .messages import (
    CAMERA_INFO,
    DIAGNOSTICS,
    OCCUPANCY_GRID,
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
    Mended,
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


class Codec(Struct, frozen=True):
    """Converts one of our message types to rosbags' objects of a ROS type and back; `from_ros`
    raises MessageError if an object is not valid."""

    message: type
    type_name: str
    to_ros: Callable[[Builder, Any], Any]
    from_ros: Callable[[Any], Any]


def _sightings_to_ros(ros: Builder, m: Sightings) -> Any:
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
    check_count("faces", len(ros.faces), MOST_FACES)
    _check_name(ros.header.frame_id)
    faces = tuple(_face_from_ros(face) for face in ros.faces)
    return Sightings(stamp_of(ros.header), ros.header.frame_id, ros.width, ros.height, faces)


def _check_name(name: str) -> None:
    check_count("bytes of a name", len(name.encode()) + 1, MOST_TEXT_BYTES)  # its end is one


def _face_from_ros(face: Any) -> FaceSighting:
    check_count("corners of a face", len(face.corners), MOST_CORNERS)
    _check_name(face.target)
    if len(face.pixels) != 2 * len(face.corners) or len(face.corners) == 0:
        raise MessageError(
            f"a face has {len(face.corners)} corners but {len(face.pixels)} pixel coordinates"
        )
    if len(set(face.corners.tolist())) != len(face.corners):
        raise MessageError("a face names a corner twice")
    finite(face.pixels, "a face")
    if not LEAST_SIGMA_PX <= face.sigma <= MOST_SIGMA_PX:
        raise MessageError(
            f"a face has a sigma of {face.sigma} px; "
            f"it must lie between {LEAST_SIGMA_PX} and {MOST_SIGMA_PX}"
        )
    if np.abs(face.pixels).max() > FURTHEST_PX:
        raise MessageError(f"a face has a corner beyond {FURTHEST_PX} pixels")
    pixels = face.pixels.reshape(-1, 2)
    return FaceSighting(face.target, face.face, face.corners, pixels, float(face.sigma))


def _odometry_to_ros(ros: Builder, m: Odometry) -> Any:
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
    _check_name(ros.header.frame_id)
    _check_name(ros.child_frame_id)
    pose, length = normalised_pose_of(ros.pose.pose)
    twist = ros.twist.twist
    velocities = np.array([[v.x, v.y, v.z] for v in (twist.linear, twist.angular)], dtype=float)
    is_known = np.isfinite(velocities)
    lacks = {
        Mended.NOT_NORMALISED: abs(length - 1) > UNIT_TOLERANCE,
        Mended.NO_TWIST: not is_known.all(),
    }
    return Odometry(
        stamp_of(ros.header),
        ros.header.frame_id,
        ros.child_frame_id,
        pose,
        *np.where(is_known, velocities, 0.0),
        mended=tuple(lack for lack, is_so in lacks.items() if is_so),
    )


def _estimate_to_ros(ros: Builder, m: PoseEstimate) -> Any:
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
    covariance = finite(ros.pose.covariance, "a covariance").reshape(6, 6)
    return PoseEstimate(
        stamp_of(ros.header), ros.header.frame_id, pose_of(ros.pose.pose), covariance
    )


def _pose_stamped_to_ros(ros: Builder, m: PoseStamped) -> Any:
    header = ros.header(m.stamp_ns, m.frame_id)
    return ros("geometry_msgs/PoseStamped", header=header, pose=ros.pose(m.pose))


def _pose_stamped_from_ros(ros: Any) -> PoseStamped:
    return PoseStamped(stamp_of(ros.header), ros.header.frame_id, pose_of(ros.pose))


def _pose_array_to_ros(ros: Builder, m: PoseArray) -> Any:
    poses = [ros.pose(m.poses[i]) for i in range(len(m.poses))]
    return ros(
        "geometry_msgs/PoseArray",
        header=ros.header(m.stamp_ns, m.frame_id),
        poses=poses,
    )


def _pose_array_from_ros(ros: Any) -> PoseArray:
    poses = Pose.stack([pose_of(pose) for pose in ros.poses])
    return PoseArray(stamp_of(ros.header), ros.header.frame_id, poses)


def _picture_to_ros(ros: Builder, m: Picture) -> Any:
    return ros(
        "sensor_msgs/CompressedImage",
        header=ros.header(m.stamp_ns, m.frame_id),
        format=m.format,
        data=np.frombuffer(m.data, np.uint8),
    )


def _picture_from_ros(ros: Any) -> Picture:
    return Picture(stamp_of(ros.header), ros.header.frame_id, ros.format, ros.data.tobytes())


def _camera_info_to_ros(ros: Builder, m: CameraInfo) -> Any:
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
    k = finite(ros.k, "a camera matrix")
    distortion = tuple(finite(ros.d, "a distortion").tolist())
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
    return CameraInfo(stamp_of(ros.header), ros.header.frame_id, camera)


def _transforms_to_ros(ros: Builder, m: Transforms) -> Any:
    return ros(
        "tf2_msgs/TFMessage",
        transforms=[_transform_to_ros(ros, t) for t in m.transforms],
    )


def _transform_to_ros(ros: Builder, t: Transform) -> Any:
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
    pose = pose_of(SimpleNamespace(position=both.translation, orientation=both.rotation))
    return Transform(stamp_of(t.header), t.header.frame_id, t.child_frame_id, pose)


def _polygon_to_ros(ros: Builder, m: Polygon) -> Any:
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
    array = finite(points, "a polygon").reshape(-1, 3)
    return Polygon(stamp_of(ros.header), ros.header.frame_id, array)


def _grid_to_ros(ros: Builder, m: OccupancyGrid) -> Any:
    header = ros.header(m.stamp_ns, m.frame_id)
    rows, columns = m.values.shape
    info = ros(
        "nav_msgs/MapMetaData",
        map_load_time=header.stamp,
        resolution=m.cell_m,
        width=columns,
        height=rows,
        origin=ros.pose(m.origin),
    )
    data = np.ascontiguousarray(m.values, np.int8).reshape(-1)
    return ros("nav_msgs/OccupancyGrid", header=header, info=info, data=data)


def _grid_from_ros(ros: Any) -> OccupancyGrid:
    rows, columns, cell_m = ros.info.height, ros.info.width, float(ros.info.resolution)
    if len(ros.data) != rows * columns:
        raise MessageError(f"a grid of {rows} × {columns} cells has {len(ros.data)} values")
    if not 0 < cell_m < np.inf:
        raise MessageError(f"a grid has cells of {cell_m} m")
    if len(ros.data) and not (ros.data.min() >= -1 and ros.data.max() <= 100):
        raise MessageError("a grid has a value that is not from -1 to 100")
    values = ros.data.reshape(rows, columns)
    origin = pose_of(ros.info.origin)
    return OccupancyGrid(stamp_of(ros.header), ros.header.frame_id, cell_m, origin, values)


def _diagnostics_to_ros(ros: Builder, m: Diagnostics) -> Any:
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
            _level_from_ros(status),
            status.name,
            status.message,
            status.hardware_id,
            {pair.key: pair.value for pair in status.values},
        )
        for status in ros.status
    )
    return Diagnostics(stamp_of(ros.header), statuses)


def _level_from_ros(status: Any) -> int:
    level = status.level & 0xFF  # an octet, which rosbags reads as signed
    if level > MOST_LEVEL:
        raise MessageError(f"«{status.name}» has the level {level}; {MOST_LEVEL} is the highest")
    return level


CODECS = (
    Codec(Sightings, SIGHTINGS, _sightings_to_ros, _sightings_from_ros),
    Codec(Odometry, ODOMETRY, _odometry_to_ros, _odometry_from_ros),
    Codec(PoseEstimate, POSE_ESTIMATE, _estimate_to_ros, _estimate_from_ros),
    Codec(PoseStamped, POSE_STAMPED, _pose_stamped_to_ros, _pose_stamped_from_ros),
    Codec(PoseArray, POSE_ARRAY, _pose_array_to_ros, _pose_array_from_ros),
    Codec(Picture, PICTURE, _picture_to_ros, _picture_from_ros),
    Codec(CameraInfo, CAMERA_INFO, _camera_info_to_ros, _camera_info_from_ros),
    Codec(Transforms, TRANSFORMS, _transforms_to_ros, _transforms_from_ros),
    Codec(Polygon, POLYGON, _polygon_to_ros, _polygon_from_ros),
    Codec(OccupancyGrid, OCCUPANCY_GRID, _grid_to_ros, _grid_from_ros),
    Codec(Diagnostics, DIAGNOSTICS, _diagnostics_to_ros, _diagnostics_from_ros),
)
