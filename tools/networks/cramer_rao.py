"""The Cramér-Rao bound of a session: the least covariance that any unbiased estimator can reach.

It is the inverse of the Fisher information at the truth, with everything known that an oracle would
know: which sightings are good, which face each shows, when a camera was moved or a robot lifted.
For Gaussian noise the information is the normal equations' matrix at the true state (Kay,
«Estimation Theory», 1993, section 3.9); what has a prior adds the prior's information.
"""

from collections.abc import Mapping

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from trigpoint.fusion.model.assembly import Assembled, assemble
from trigpoint.fusion.model.dataset import DataSet, Entry
from trigpoint.fusion.model.observations import Observation, Verdict
from trigpoint.fusion.model.odometry import OdometryTrack
from trigpoint.fusion.model.problem import CameraState, State
from trigpoint.fusion.reading.best_readings import best_readings
from trigpoint.fusion.solver.levenberg_marquardt import linearise
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from .distances import expected_error, joint_distances

# Further than any robot moves in a step: the motion before it is taken as unknown.
_AWAY = Pose.planar(1e6, 0.0, 0.0)


class Bound(Struct, frozen=True):
    """`cameras`: names in order; `covariance`: (6n, 6n) of their poses; `places`: (n, 3), true."""

    cameras: list[str]
    covariance: Array
    places: Array

    def of(self, names: list[str]) -> "Bound":
        """The bound of some of the cameras, in this order."""
        chosen = [self.cameras.index(name) for name in names]
        rows = np.array([6 * index + axis for index in chosen for axis in range(6)], dtype=int)
        return Bound(names, self.covariance[np.ix_(rows, rows)], self.places[chosen])

    @property
    def mean_distance_error(self) -> float:
        """Expected mean absolute error of the distances between cameras, metres."""
        if len(self.cameras) < 2:
            return 0.0
        ends = np.stack(np.triu_indices(len(self.cameras), k=1), axis=1)
        _, covariance = joint_distances(self.places, self.covariance, ends)
        return expected_error(np.sqrt(np.diagonal(covariance)))


class Oracle(Struct, frozen=True):
    """The truth. `cameras`: where each is, with its lens and time offset; `places`: observations
    with the robot's true pose at each. One that has no `chosen` readings is read as it fits best.
    What a mapping leaves out is as the site says: no scale errors (2,), faces where the target file
    has them, no robot lifted at any stamp."""

    cameras: Mapping[str, CameraState]
    places: list[tuple[Observation, Pose]]
    scale_errors: Mapping[str, Array] = field(default_factory=dict)
    base_from_face: Mapping[str, Pose] = field(default_factory=dict)
    lifted_ns: Mapping[str, list[int]] = field(default_factory=dict)


def cramer_rao(data: DataSet, oracle: Oracle) -> Bound:
    """The bound of the cameras' poses.

    `data` gives site, priors, targets, lenses that are told, and odometry; the odometry's noise is
    taken as the contract states it, with nothing added.
    """
    assembled = oracle_problem(data, oracle)
    reduced = linearise(assembled.problem, assembled.start).reduced()
    names = list(reduced.layout.pose)
    columns = np.concatenate(list(reduced.layout.pose.values()))
    covariance = reduced.covariance()[np.ix_(columns, columns)]
    places = [oracle.cameras[name].map_from_camera.translation for name in names]
    return Bound(names, covariance, np.array(places))


def oracle_problem(data: DataSet, oracle: Oracle) -> Assembled:
    """What an oracle would solve, with the truth for a start; arguments as `cramer_rao`'s."""
    true_cameras = {n: c for n, c in oracle.cameras.items() if n in data.lenses}
    entries = []
    for observation, map_from_base in oracle.places:
        if observation.camera in true_cameras:
            read = _read(data, observation, true_cameras[observation.camera], map_from_base)
            entries.append(Entry(read.judged(Verdict.ACCEPTED), map_from_base))
    tracks = {n: _stated(t, oracle.lifted_ns.get(n, [])) for n, t in data.tracks.items()}
    told = DataSet(data.site, data.targets, data.lenses, data.known, tracks, entries)
    state = State(true_cameras, told.first_state().robots)
    for name, robot in state.robots.items():
        state.robots[name] = replace(
            robot,
            scales=np.asarray(oracle.scale_errors.get(name, robot.scales)),
            base_from_face=oracle.base_from_face.get(name, robot.base_from_face),
        )
    return assemble(told, state, list(range(len(entries))))


def _read(
    data: DataSet, observation: Observation, camera: CameraState, map_from_base: Pose
) -> Observation:
    if observation.chosen is not None:
        return observation
    target = data.targets[observation.robot]
    camera_from_base = camera.map_from_camera.inverse() @ map_from_base
    there = camera_from_base.repeated(len(observation.views))
    readings, _ = best_readings(observation.views, target, camera.lens, there)
    return observation.read_as(tuple(readings))


def _stated(track: OdometryTrack, lifted_ns: list[int]) -> OdometryTrack:
    """The same odometry with only the contract's noise, and unknown motion during lifts."""
    stated = OdometryTrack(track.noise, planar=track.planar, slip=0.0)
    poses = track.odom_from_base
    for index, stamp_ns in enumerate(track.stamps_ns.tolist()):
        pose = poses[index]
        for lift_ns in lifted_ns:
            if stamp_ns >= lift_ns:
                pose = _AWAY @ pose
        stated.add(stamp_ns, pose)
    return stated
