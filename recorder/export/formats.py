"""A network in the formats of other tools: Kalibr's camchain, ROS camera_info, a launch file."""

import math
from io import StringIO

import numpy as np
from ruamel.yaml import YAML

from trigpoint.base.errors import InputError
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.camera import LensModel
from trigpoint.map.building import Building
from trigpoint.map.network import Network, PoseRecord

_RADTAN_COEFFICIENTS = 4
_SMALL_PX = 0.1
"""Where a lens's further coefficients move no pixel by more than this, radtan says it all."""


def camchain(network: Network) -> tuple[str, list[str]]:
    """Kalibr's camchain.yaml of the located cameras ("" where it can say none), and what it cannot
    say.

    Kalibr knows four coefficients of a pinhole's distortion and its equidistant lens; a camera
    whose lens needs more is left out. T_cn_cnm1 maps camera n-1's coordinates to camera n's.
    """
    chain: dict[str, object] = {}
    left_out: list[str] = []
    before: Pose | None = None
    for name in network.located:
        record = network.cameras[name]
        assert record.map_from_camera is not None
        lens = record.intrinsics.camera if record.intrinsics else None
        distortion = _kalibr_distortion(lens) if lens else None
        if lens is None or distortion is None:
            left_out.append(
                f"{name}: its lens needs more than the four coefficients that Kalibr knows"
            )
            continue
        entry: dict[str, object] = {
            "camera_model": "pinhole",
            "intrinsics": [lens.fx, lens.fy, lens.cx, lens.cy],
            "distortion_model": distortion[0],
            "distortion_coeffs": distortion[1],
            "resolution": [lens.width, lens.height],
            "rostopic": f"/{network.site}/camera/{name}/image/compressed",
        }
        pose = record.map_from_camera.pose
        if before is not None:
            entry["T_cn_cnm1"] = _matrix(pose.inverse() @ before)
        before = pose
        chain[f"cam{len(chain)}"] = entry
    if not chain:
        return "", left_out
    text = StringIO()
    yaml = YAML()
    yaml.default_flow_style = None
    yaml.dump(chain, text)
    return text.getvalue(), left_out


def _matrix(pose: Pose) -> list[list[float]]:
    rows = np.eye(4)
    rows[:3, :3], rows[:3, 3] = pose.rotation, pose.translation
    return rows.tolist()


def _kalibr_distortion(lens: CameraModel) -> tuple[str, list[float]] | None:
    coefficients = [float(value) for value in lens.distortion]
    if lens.model is LensModel.EQUIDISTANT:
        return "equi", [*coefficients, 0.0, 0.0, 0.0, 0.0][:_RADTAN_COEFFICIENTS]
    if lens.model is not LensModel.PLUMB_BOB:
        return None
    first, rest = coefficients[:_RADTAN_COEFFICIENTS], coefficients[_RADTAN_COEFFICIENTS:]
    corner = math.hypot(lens.width / 2 / lens.fx, lens.height / 2 / lens.fy)
    if any(abs(k) * corner**7 * lens.fx > _SMALL_PX for k in rest):  # k3 r⁶, times r
        return None
    return "radtan", [*first, 0.0, 0.0, 0.0, 0.0][:_RADTAN_COEFFICIENTS]


def launch_file(network: Network, building: Building | None = None) -> str:
    """A ROS 2 launch file that puts every located camera on /tf_static, and the map into its
    building's frame."""
    nodes = []
    for name in network.located:
        record = network.cameras[name].map_from_camera
        assert record is not None
        nodes.append(_static("map", f"{name}/optical", record))
    if not nodes:
        raise InputError("no camera is located, so there is nothing to launch")
    if building is not None:
        nodes.append(_static(building.frame, "map", PoseRecord.of(building.frame_from_map)))
    return _LAUNCH.format(site=network.site, nodes="".join(nodes))


def _static(parent: str, child: str, record: PoseRecord) -> str:
    numbers = ", ".join(repr(value) for value in (*record.translation, *record.quaternion))
    return f'        static("{parent}", "{child}", {numbers}),\n'


_LAUNCH = '''\
"""The located cameras of site {site} as static transforms: `ros2 launch cameras.launch.py`."""

from launch import LaunchDescription
from launch_ros.actions import Node


def static(parent, frame, x, y, z, qx, qy, qz, qw):
    """parent -> frame; metres and a unit quaternion."""
    values = dict(x=x, y=y, z=z, qx=qx, qy=qy, qz=qz, qw=qw)
    arguments = [word for name, value in values.items() for word in ("--" + name, repr(value))]
    return Node(
        package="tf2_ros",
        executable="static_transform_publisher",
        name=frame.replace("/", "_"),
        arguments=[*arguments, "--frame-id", parent, "--child-frame-id", frame],
    )


def generate_launch_description():
    return LaunchDescription([
{nodes}    ])
'''
