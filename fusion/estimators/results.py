"""The estimator's results in the form of the network file."""

from collections.abc import Iterable
from pathlib import Path
from uuid import NAMESPACE_URL, UUID, uuid5

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.fusion.association.explanation import Alternative
from trigpoint.fusion.model.dataset import DataSet, Move
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.map.network import (
    AlternativeRecord,
    CameraRecord,
    EarlierPose,
    FaceRecord,
    IntrinsicsRecord,
    Network,
    PoseRecord,
    RobotRecord,
    Statistics,
    TargetRecord,
    save_network,
)

from .crept import newest_ns
from .interface import CameraEstimate, Estimator, Trajectory
from .noise_lines import noise_lines
from .rejected_faces import rejected_faces


class Results(Struct, frozen=True):
    """The network, its joint covariance (6n, 6n), robot -> (stamps_ns, map_from_base), which
    `noise` is not as stated, and what of the target files cannot be (`doubts`), in words."""

    network: Network
    covariance: Array
    trajectories: dict[str, tuple[np.ndarray, Pose]]
    noise: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()

    def unlocated(self, why: str) -> "Results":
        """The same where every place that a camera was seen from is wrong, so that none is located;
        one that saw nothing is where it was known to be."""
        cameras = {
            name: replace(
                camera,
                status="undetermined",
                undetermined=(why, *camera.undetermined),
                alternatives=(),
                map_from_camera=None,
                covariance=None,
                earlier=(),
            )
            if camera.sightings
            else camera
            for name, camera in self.network.cameras.items()
        }
        left = [cameras[name].status == "located" for name in self.network.located]
        rows = np.flatnonzero(np.repeat(left, 6))
        network = replace(self.network, cameras=cameras)
        return replace(self, network=network, covariance=self.covariance[np.ix_(rows, rows)])

    def save(self, directory: Path) -> None:
        """Write network.json, covariance.npz and the trajectories."""
        save_network(
            directory, self.network, covariance=self.covariance, trajectories=self.trajectories
        )


def map_id_of(data: DataSet) -> UUID | None:
    """The map's identity; None before the first robot's first odometry message."""
    since_ns = data.map_since_ns
    if since_ns is None:
        return None
    first = data.site.first_robot
    return uuid5(NAMESPACE_URL, f"trigpoint:{data.site.name}/{first}/{since_ns}")


def results_of(data: DataSet, estimator: Estimator) -> Results:
    """Collect everything that is known now."""
    map_id = map_id_of(data)
    located, undetermined = estimator.cameras(), estimator.undetermined()
    cameras = {
        name: _camera(data, estimator, name, located.get(name), undetermined.get(name))
        for name in data.site.cameras
    }
    ways = {name: estimator.trajectory(name) for name in data.site.robots}
    robots = {name: _robot(data, estimator, name, way) for name, way in ways.items()}
    until_ns = newest_ns(data)
    network = Network(
        site=data.site.name,
        map_id=str(map_id) if map_id is not None else "",
        estimator=data.site.fusion.estimator,
        cameras=cameras,
        robots=robots,
        statistics=Statistics(estimator.chi2_per_dof, estimator.iterations),
        until=str(until_ns) if until_ns is not None else None,
    )
    return Results(
        network,
        estimator.joint_covariance(),
        {name: way for name, way in ways.items() if way is not None},
        noise_lines(data),
        rejected_faces(data),
    )


def _camera(
    data: DataSet,
    estimator: Estimator,
    name: str,
    located: CameraEstimate | None,
    undetermined: tuple[str, ...] | None,
) -> CameraRecord:
    count = estimator.count(name)
    earlier = (*data.past_of(name).earlier, *earlier_poses(data.moves, name))
    if located is not None:
        return CameraRecord(
            status="located",
            confirmed=count.is_confirmed,
            map_from_camera=PoseRecord.of(located.map_from_camera),
            covariance=tuple(located.covariance.reshape(-1).tolist()),
            intrinsics=IntrinsicsRecord.of(located.lens, located.lens_sigma),
            time_offset=located.time_offset_s,
            time_offset_sigma=located.time_offset_sigma_s,
            sightings=count.sightings,
            rejected=count.rejected,
            reprojection_rms=count.reprojection_rms,
            earlier=earlier,
        )
    lens = data.lenses.get(name)
    intrinsics = None
    if lens is not None:
        intrinsics = IntrinsicsRecord.of(lens, np.zeros(len(lens.parameters)))
    if undetermined is None:
        return CameraRecord(status="unseen", intrinsics=intrinsics)
    return CameraRecord(
        status="undetermined",
        undetermined=undetermined,
        alternatives=tuple(_alternative(place) for place in estimator.alternatives(name)),
        intrinsics=intrinsics,
        sightings=count.sightings,
        rejected=count.rejected,
        earlier=earlier,
    )


def _alternative(place: Alternative) -> AlternativeRecord:
    covariance = tuple(place.covariance.reshape(-1).tolist())
    return AlternativeRecord(PoseRecord.of(place.map_from_camera), covariance, place.probability)


def earlier_poses(moves: Iterable[Move], camera: str) -> tuple[EarlierPose, ...]:
    """Where a camera was located before each of its moves, the oldest first."""
    return tuple(
        EarlierPose(
            str(move.until_ns),
            PoseRecord.of(move.map_from_camera),
            tuple(move.covariance.reshape(-1).tolist()),
        )
        for move in moves
        if move.camera == camera
        and move.map_from_camera is not None
        and move.covariance is not None
    )


def _robot(
    data: DataSet, estimator: Estimator, name: str, trajectory: Trajectory | None
) -> RobotRecord:
    target, track = data.targets[name], data.tracks[name]
    base_from_face = estimator.base_from_faces(name)
    faces = []
    for index, face in enumerate(target.faces):
        record = PoseRecord.of(base_from_face[index])
        faces.append(FaceRecord(face.id, record.translation, record.quaternion))
    map_from_odom = None
    if trajectory is not None and len(track) and trajectory.stamps_ns[-1] == track.last_ns:
        map_from_odom = PoseRecord.of(trajectory.map_from_base[-1] @ track.reported.inverse())
    distance_scale, heading_scale = (1 + estimator.scales(name)).tolist()
    return RobotRecord(
        trajectory=f"{name}.tum" if trajectory is not None else None,
        distance_scale=distance_scale,
        heading_scale=heading_scale,
        map_from_odom=map_from_odom,
        target=TargetRecord(tuple(faces)),
    )
