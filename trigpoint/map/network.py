"""network.json, the result of a calibration; its format is section 4 of the contract."""

import io
import math
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
from msgspec import Struct

from trigpoint.base.clock import NANOSECONDS
from trigpoint.base.disk import replace_file
from trigpoint.base.errors import InputError, read_text, writing
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.camera import LensModel
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import position_sigma

FORMAT = "trigpoint-network/1"
ON_ONE_SIGHTING = (
    "rests on one sighting alone, which may have been wrong; drive past it again, where it sees "
    "the robot from elsewhere"
)
"""Remark on a located camera that is not `confirmed`."""

Status = Literal["located", "undetermined", "unseen"]


class PoseRecord(Struct, frozen=True):
    """A transform: metres, quaternion x, y, z, w."""

    translation: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]

    @classmethod
    def of(cls, pose: Pose) -> "PoseRecord":
        x, y, z = (float(value) for value in pose.translation)
        i, j, k, w = (float(value) for value in pose.quaternion)
        return cls((x, y, z), (i, j, k, w))

    @property
    def pose(self) -> Pose:
        return Pose.from_quaternion(self.translation, self.quaternion)


class IntrinsicsSigma(Struct, frozen=True):
    """Standard deviations; 0 if a value was taken as known."""

    fx: float
    fy: float
    cx: float
    cy: float
    d: tuple[float, ...]


class IntrinsicsRecord(Struct, frozen=True):
    """A lens; `k` is row-major 3 × 3."""

    model: str
    width: int
    height: int
    k: tuple[float, ...]
    d: tuple[float, ...]
    sigma: IntrinsicsSigma

    @classmethod
    def of(cls, camera: CameraModel, sigma: Array) -> "IntrinsicsRecord":
        """`sigma`: of `camera.parameters`, same order."""
        fx, fy, cx, cy, *distortion = (float(value) for value in sigma)
        return cls(
            model=camera.model.value,
            width=camera.width,
            height=camera.height,
            k=tuple(float(value) for value in camera.matrix.reshape(-1)),
            d=camera.distortion,
            sigma=IntrinsicsSigma(fx, fy, cx, cy, tuple(distortion)),
        )

    @property
    def camera(self) -> CameraModel:
        fx, fy, cx, cy = (self.k[i] for i in (0, 4, 2, 5))
        return CameraModel(self.width, self.height, fx, fy, cx, cy, self.d, LensModel(self.model))


class EarlierPose(Struct, frozen=True):
    """Where a camera was before it was moved; `until`: the stamp, nanoseconds as text."""

    until: str
    map_from_camera: PoseRecord
    covariance: tuple[float, ...]


class AlternativeRecord(Struct, frozen=True):
    """A place that the data do not rule out; `probability`: its share of the posterior."""

    map_from_camera: PoseRecord
    covariance: tuple[float, ...]
    probability: float


class CameraRecord(Struct, frozen=True, omit_defaults=False):
    """One camera; pose and covariance only if it is located.

    `undetermined`: what the data leave open, or why nothing that an unseen camera saw was used;
    `confirmed`: false if everything rests on one sighting; `alternatives`: if it is undetermined,
    the possible places, best first.
    """

    status: Status
    undetermined: tuple[str, ...] = ()
    alternatives: tuple[AlternativeRecord, ...] = ()
    confirmed: bool = True
    map_from_camera: PoseRecord | None = None
    covariance: tuple[float, ...] | None = None
    intrinsics: IntrinsicsRecord | None = None
    time_offset: float = 0.0
    time_offset_sigma: float = 0.0
    sightings: int = 0
    rejected: int = 0
    reprojection_rms: float | None = None
    earlier: tuple[EarlierPose, ...] = ()

    @property
    def covariance_matrix(self) -> Array:
        """(6, 6); raise ValueError if the camera is not located."""
        if self.covariance is None:
            raise ValueError(f"the camera is {self.status} and has no covariance")
        return np.array(self.covariance).reshape(6, 6)

    @property
    def position_sigma(self) -> float:
        """Square root of the position covariance's trace, metres."""
        return position_sigma(self.covariance_matrix)

    @property
    def rotation_sigma(self) -> float:
        """Square root of the rotation covariance's trace, radians."""
        return math.sqrt(float(np.trace(self.covariance_matrix[3:, 3:])))


class FaceRecord(Struct, frozen=True):
    """base_from_face."""

    id: int
    translation: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]


class TargetRecord(Struct, frozen=True):
    faces: tuple[FaceRecord, ...]


class RobotRecord(Struct, frozen=True):
    """One robot; `trajectory` is a TUM file beside the network, map_from_base per odometry message.

    `map_from_odom` is the last one; null if the robot could not be tied to the map.
    """

    trajectory: str | None
    distance_scale: float
    heading_scale: float
    map_from_odom: PoseRecord | None
    target: TargetRecord


class Statistics(Struct, frozen=True):
    chi2_per_dof: float | None
    iterations: int


class Network(Struct, frozen=True):
    """The whole file. `until`: the stamp of its newest sighting, nanoseconds as text, which is the
    time of the covariances; null in files that do not say it."""

    site: str
    map_id: str
    estimator: str
    cameras: dict[str, CameraRecord]
    robots: dict[str, RobotRecord]
    statistics: Statistics
    format: str = FORMAT
    map: str = "map"
    until: str | None = None

    @property
    def until_ns(self) -> int | None:
        """`until` as a number."""
        return None if self.until is None else int(self.until)

    @property
    def located(self) -> list[str]:
        """Names of the located cameras, in order."""
        return [name for name, camera in self.cameras.items() if camera.status == "located"]


def encode_network(network: Network) -> bytes:
    """The file's bytes; the same network always gives the same bytes."""
    return msgspec.json.format(msgspec.json.encode(network), indent=1) + b"\n"


def decode_network(data: bytes, *, source: str = "network.json") -> Network:
    """A network from the file's bytes; raise InputError with a one-line message."""
    try:
        network = msgspec.json.decode(data, type=Network)
    except msgspec.DecodeError as reason:
        raise InputError(f"{source}: no network file ({reason}); give a network.json") from None
    if network.format != FORMAT:
        raise InputError(f"{source}: format «{network.format}» is not {FORMAT}; calibrate again")
    if network.until is not None and not network.until.isdecimal():
        raise InputError(
            f"{source}: until «{network.until}» is no stamp in nanoseconds; calibrate again"
        )
    return network


def load_network(path: Path) -> Network:
    """Read network.json, or the one in a folder."""
    file = path / "network.json" if path.is_dir() else path
    return decode_network(read_text(file, "network file", InputError).encode(), source=str(file))


def load_covariance(path: Path, network: Network) -> Array:
    """The joint covariance (6n, 6n) beside a network file, or in its folder, in the order of the
    located cameras; raise InputError if it is missing or belongs to another network."""
    file = (path if path.is_dir() else path.parent) / "covariance.npz"
    try:
        with np.load(file, allow_pickle=False) as archive:
            joint, names = archive["covariance"], [str(name) for name in archive["cameras"]]
    except (OSError, ValueError, KeyError):
        raise InputError(
            f"{file}: no joint covariance; keep covariance.npz beside network.json"
        ) from None
    if names != network.located or joint.shape != (6 * len(names), 6 * len(names)):
        raise InputError(f"{file}: belongs to another network than {path}; calibrate again")
    return joint


def save_network(
    directory: Path,
    network: Network,
    *,
    covariance: Array,
    trajectories: dict[str, "tuple[np.ndarray, Pose]"],
) -> None:
    """Write network.json, covariance.npz (joint, 6n × 6n) and each robot's TUM file.

    Each file is written under a temporary name and then moved, so that none is ever incomplete.
    `trajectories`: robot -> (stamps_ns (n,), map_from_base). Raises OperationError if a file cannot
    be written.
    """
    archive = io.BytesIO()
    np.savez(archive, cameras=np.array(network.located), covariance=covariance)
    files = {f"{robot}.tum": encode_tum(*way) for robot, way in trajectories.items()}
    files |= {"covariance.npz": archive.getvalue(), "network.json": encode_network(network)}
    with writing(directory):
        directory.mkdir(parents=True, exist_ok=True)
        for name, data in files.items():
            replace_file(directory / name, data)


_SEVEN = " ".join(["%.9f"] * 7)


def encode_tum(stamps_ns: np.ndarray, poses: Pose) -> bytes:
    """A TUM trajectory: `t x y z qx qy qz qw` per row, seconds and metres."""
    numbers = np.hstack([poses.translation.reshape(-1, 3), poses.quaternion.reshape(-1, 4)])
    return "".join(
        f"{stamp_ns // NANOSECONDS}.{stamp_ns % NANOSECONDS:09d} {_SEVEN % tuple(row)}\n"
        for stamp_ns, row in zip(stamps_ns.tolist(), numbers.tolist(), strict=True)
    ).encode()


def load_tum(path: Path) -> tuple[np.ndarray, Pose]:
    """`decode_tum` of a file; raise InputError also where it cannot be read."""
    try:
        return decode_tum(path.read_bytes(), source=str(path))
    except OSError as reason:
        raise InputError(f"{path}: cannot be read ({reason.strerror}); check the path") from None


def decode_tum(data: bytes, *, source: str = "trajectory") -> tuple[np.ndarray, Pose]:
    """(stamps_ns (n,) int64, poses) of a TUM file; raise InputError that names the line."""
    stamps, rows = [], []
    for number, line in enumerate(data.decode(errors="replace").splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        fields = line.split()
        try:
            seconds, _, fraction = fields[0].partition(".")
            stamps.append(int(seconds) * NANOSECONDS + int((fraction + "0" * 9)[:9]))
            rows.append([float(value) for value in fields[1:]])
            if len(fields) != 8:
                raise ValueError
        except ValueError:
            raise InputError(f"{source}:{number}: no row of `t x y z qx qy qz qw`") from None
    values = np.array(rows, dtype=float).reshape(-1, 8 - 1)
    return np.array(stamps, dtype=np.int64), Pose.from_quaternion(values[:, :3], values[:, 3:])
