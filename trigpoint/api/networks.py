"""Networks from Python: cameras, covariances, distances, alternatives and trajectories in numpy.

Frames and units as everywhere: metres, radians, `map` is the first robot's odometry frame; a
covariance's order is x, y, z and rotation about the map's x, y, z.
"""

import os
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Literal

import numpy as np
from msgspec import Struct

from trigpoint.base.errors import InputError
from trigpoint.base.words import nearest
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array
from trigpoint.map import network as files
from trigpoint.tools.networks.distances import Distances, distances
from trigpoint.tools.networks.truth import NetworkError, TruthFile, load_truth, network_error

PathLike = str | os.PathLike[str]


class Trajectory(Struct, frozen=True, eq=False):
    """Where a robot's base was: `stamps_ns` (n,) int64, Unix time; `pose`: n poses, of the base in
    the map, or in the robot's odometry frame where a session's odometry was asked for."""

    stamps_ns: np.ndarray
    pose: Pose

    def __len__(self) -> int:
        return len(self.stamps_ns)


class Alternative(Struct, frozen=True, eq=False):
    """A place that the data leave open for an undetermined camera: map_from_camera, its covariance
    (6, 6), and its share of the posterior, 0 to 1."""

    pose: Pose
    covariance: Array
    probability: float


class EarlierPose(Struct, frozen=True, eq=False):
    """Where a camera was until it was moved at `until_ns`: map_from_camera, covariance (6, 6)."""

    until_ns: int
    pose: Pose
    covariance: Array


class Camera(Struct, frozen=True, eq=False):
    """One camera of a network.

    `pose`: map_from_camera (z ahead, x right, y down in the picture), `covariance` (6, 6): None
    unless `status` is located. `undetermined`: what the data leave open, in words; `alternatives`:
    the places left, best first. `confirmed`: False where all rests on one sighting. `lens_sigma`:
    of `lens.parameters`, same order, 0 where it was taken as known. True time is the camera's stamp
    minus `time_offset_s`. `sightings`, `rejected`: faces used and not. `reprojection_rms_px`: of a
    corner.
    """

    name: str
    status: Literal["located", "undetermined", "unseen"]
    pose: Pose | None
    covariance: Array | None
    confirmed: bool
    undetermined: tuple[str, ...]
    alternatives: tuple[Alternative, ...]
    earlier: tuple[EarlierPose, ...]
    lens: CameraModel | None
    lens_sigma: Array | None
    time_offset_s: float
    time_offset_sigma_s: float
    sightings: int
    rejected: int
    reprojection_rms_px: float | None

    @property
    def position_sigma(self) -> float:
        """Root of the position covariance's trace, metres; nan unless located."""
        return _root_of_trace(self.covariance, slice(0, 3))

    @property
    def rotation_sigma(self) -> float:
        """The same of the rotation, radians."""
        return _root_of_trace(self.covariance, slice(3, 6))


class Robot(Struct, frozen=True, eq=False):
    """One robot of a network: true motion = scale × reported motion; `map_from_odom`: the last one,
    None where the robot could not be tied to the map; `base_from_faces`: face id -> where the
    target's face is on the robot."""

    name: str
    distance_scale: float
    heading_scale: float
    map_from_odom: Pose | None
    base_from_faces: dict[int, Pose]


class Network(Struct, frozen=True, eq=False):
    """What a calibration ends in. `cameras`, `robots`: by name, in the site file's order;
    `chi2_per_dof`: 1 on average where the noise is as stated, None where the estimator has none."""

    site: str
    map_id: str
    frame: str
    estimator: str
    cameras: dict[str, Camera]
    robots: dict[str, Robot]
    chi2_per_dof: float | None
    _record: files.Network
    _covariance: Callable[[], Array]
    _trajectory: Callable[[str], Trajectory]

    @property
    def located(self) -> list[str]:
        """Names of the located cameras, in order."""
        return self._record.located

    def covariance(self, names: Iterable[str] | None = None) -> Array:
        """The joint covariance (6n, 6n) of located cameras, in the order of `names`, by default
        all. Raises InputError for another camera, and where there is no covariance.npz beside the
        file."""
        chosen = self.located if names is None else list(names)
        first = np.array([6 * self._index(name) for name in chosen], dtype=int)
        rows = (first[:, None] + np.arange(6)).reshape(-1)
        return self._covariance()[np.ix_(rows, rows)]

    def distances(self, pairs: Iterable[tuple[str, str]] | None = None) -> Distances:
        """Distances between located cameras, by default of every pair, with sigmas from the joint
        covariance; raises InputError like `covariance`."""
        chosen = list(combinations(self.located, 2) if pairs is None else pairs)
        for name in {name for pair in chosen for name in pair}:
            self._index(name)
        return distances(self._record, self._covariance(), chosen)

    def trajectory(self, robot: str) -> Trajectory:
        """A robot's way in the map, a pose an odometry message; raises InputError where there is
        none of it."""
        record = self._record.robots.get(robot)
        if record is None:
            raise InputError(f"the network has no robot «{robot}»{nearest(robot, self.robots)}")
        if record.trajectory is None:
            raise InputError(f"robot {robot} could not be tied to the map and has no trajectory")
        return self._trajectory(robot)

    def errors(self, truth: PathLike | Mapping[str, Pose]) -> NetworkError:
        """The located cameras against a truth: a truth.json, or camera -> map_from_camera."""
        if isinstance(truth, Mapping):
            known = TruthFile({name: files.PoseRecord.of(pose) for name, pose in truth.items()})
        else:
            known = load_truth(Path(truth))
        return network_error(self._record, self._covariance(), known)

    def _index(self, name: str) -> int:
        if name not in self.cameras:
            raise InputError(f"the network has no camera «{name}»{nearest(name, self.cameras)}")
        if name not in self.located:
            raise InputError(f"camera {name} is {self.cameras[name].status} and has no place")
        return self.located.index(name)


def read_trajectory(path: PathLike) -> Trajectory:
    """Read a TUM file: rows of `t x y z qx qy qz qw`, seconds and metres. Raises InputError that
    names the line."""
    return Trajectory(*files.load_tum(Path(path)))


def read_network(path: PathLike) -> Network:
    """Read a network.json, or the one in a folder; covariance.npz and trajectories beside it are
    read when they are asked for. Raises InputError."""
    place = Path(path)
    record = files.load_network(place)
    folder = place if place.is_dir() else place.parent
    return network_of(
        record,
        covariance=partial(files.load_covariance, place, record),
        trajectory=lambda robot: read_trajectory(folder / str(record.robots[robot].trajectory)),
    )


def network_of(
    record: files.Network,
    *,
    covariance: Callable[[], Array],
    trajectory: Callable[[str], Trajectory],
) -> Network:
    """The network of a file's content, and where the rest of it comes from."""
    return Network(
        site=record.site,
        map_id=record.map_id,
        frame=record.map,
        estimator=record.estimator,
        cameras={name: _camera(name, camera) for name, camera in record.cameras.items()},
        robots={name: _robot(name, robot) for name, robot in record.robots.items()},
        chi2_per_dof=record.statistics.chi2_per_dof,
        _record=record,
        _covariance=covariance,
        _trajectory=trajectory,
    )


def _camera(name: str, record: files.CameraRecord) -> Camera:
    lens = record.intrinsics
    sigma = lens.sigma if lens is not None else None
    return Camera(
        name=name,
        status=record.status,
        pose=record.map_from_camera.pose if record.map_from_camera is not None else None,
        covariance=record.covariance_matrix if record.covariance is not None else None,
        confirmed=record.confirmed,
        undetermined=record.undetermined,
        alternatives=tuple(
            Alternative(place.map_from_camera.pose, _square(place.covariance), place.probability)
            for place in record.alternatives
        ),
        earlier=tuple(
            EarlierPose(int(then.until), then.map_from_camera.pose, _square(then.covariance))
            for then in record.earlier
        ),
        lens=lens.camera if lens is not None else None,
        lens_sigma=np.array([sigma.fx, sigma.fy, sigma.cx, sigma.cy, *sigma.d]) if sigma else None,
        time_offset_s=record.time_offset,
        time_offset_sigma_s=record.time_offset_sigma,
        sightings=record.sightings,
        rejected=record.rejected,
        reprojection_rms_px=record.reprojection_rms,
    )


def _robot(name: str, record: files.RobotRecord) -> Robot:
    faces = record.target.faces
    return Robot(
        name=name,
        distance_scale=record.distance_scale,
        heading_scale=record.heading_scale,
        map_from_odom=record.map_from_odom.pose if record.map_from_odom is not None else None,
        base_from_faces={
            face.id: Pose.from_quaternion(face.translation, face.quaternion) for face in faces
        },
    )


def _square(numbers: tuple[float, ...]) -> Array:
    return np.array(numbers).reshape(6, 6)


def _root_of_trace(covariance: Array | None, rows: slice) -> float:
    return float("nan") if covariance is None else float(np.trace(covariance[rows, rows]) ** 0.5)
