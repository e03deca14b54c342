"""Another network, or the truth, drawn over a session: any network.json or truth.json."""

from pathlib import Path

import msgspec
import numpy as np
import rerun as rr
from msgspec import Struct

from trigpoint.base.errors import InputError
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.map.network import PoseRecord, decode_network, load_tum

from . import style
from .camera import FRUSTUM_DEPTH_M
from .columns import Columns

_BESIDE = ("truth.json", "network.json", "calibration/network.json")
_MAP = "map"
_WIDTH, _HEIGHT = 0.5, 0.375  # of a drawn camera, in its depth


class _Truth(msgspec.Struct, frozen=True):
    cameras: dict[str, PoseRecord]
    robots: dict[str, str] = {}


class Overlay(Struct, frozen=True):
    """Camera poses and paths of robots, (n, 3), to be drawn in one colour."""

    name: str
    colour: style.Colour
    cameras: dict[str, Pose]
    paths: dict[str, Array]


def load_overlay(path: Path) -> Overlay:
    """A network.json or a truth.json; raise InputError where it is neither."""
    try:
        data = path.read_bytes()
    except OSError as reason:
        raise InputError(f"{path}: cannot be read ({reason.strerror}); check the path") from None
    if b"trigpoint-network" in data:
        network = decode_network(data, source=str(path))
        if network.map != _MAP:
            raise InputError(
                f"{path}: is in the frame «{network.map}», not in the session's map; give the "
                "network.json of its calibration"
            )
        records = {name: network.cameras[name].map_from_camera for name in network.located}
        cameras = {name: record.pose for name, record in records.items() if record is not None}
        return Overlay(path.stem, style.OVERLAY, cameras, {})
    try:
        truth = msgspec.json.decode(data, type=_Truth)
    except msgspec.DecodeError as reason:
        raise InputError(f"{path}: neither a network nor a truth file ({reason})") from None
    poses = {name: record.pose for name, record in truth.cameras.items()}
    paths = {name: _path(path.parent / file) for name, file in truth.robots.items()}
    drawn = {name: points for name, points in paths.items() if len(points)}
    return Overlay(path.stem, style.TRUTH, poses, drawn)


def overlays_beside(folder: Path) -> list[Overlay]:
    """Those that lie in a session's folder."""
    return [load_overlay(p) for name in _BESIDE if (p := folder / name).is_file()]


def draw(overlay: Overlay, columns: Columns) -> None:
    """Send it, for every time."""
    for name, pose in overlay.cameras.items():
        lines = [pose @ strip for strip in _PYRAMID]
        columns.fixed(
            f"/map/beside/{overlay.name}/{name}",
            rr.LineStrips3D(lines, colors=[overlay.colour], radii=[style.ui_points(1.0)]),
        )
    for name, points in overlay.paths.items():
        columns.fixed(
            f"/map/beside/{overlay.name}/{name}",
            rr.LineStrips3D([points], colors=[overlay.colour], radii=[style.ui_points(1.0)]),
        )


def _path(file: Path) -> Array:
    if not file.is_file():
        return np.empty((0, 3))
    _, poses = load_tum(file)
    return poses.translation.reshape(-1, 3)


def _pyramid() -> list[Array]:
    corners = FRUSTUM_DEPTH_M * np.array(
        [[x * _WIDTH, y * _HEIGHT, 1.0] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    )
    apex = np.zeros(3)
    return [np.array([*corners, corners[0]]), *(np.array([apex, corner]) for corner in corners)]


_PYRAMID = _pyramid()
