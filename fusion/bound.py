"""The Cramér-Rao bound of a session: the least covariance that any unbiased estimator can reach.

It is the inverse of the Fisher information at the truth, with everything known that an oracle would
know: which sightings are good and which face each shows. For Gaussian noise the information is the
normal equations' matrix at the true state (Kay, «Estimation Theory», 1993, section 3.9).
"""

from dataclasses import dataclass

import numpy as np

from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from .assembly import assemble
from .dataset import DataSet, Entry
from .equations import linearise
from .faces import best_reading
from .observations import Observation, Verdict
from .odometry_track import OdometryTrack
from .problem import CameraState, State
from .solver import reduce


@dataclass(frozen=True, slots=True)
class Bound:
    """`cameras`: names in order; `covariance`: (6n, 6n) of their poses; `places`: (n, 3), true."""

    cameras: list[str]
    covariance: Array
    places: Array

    @property
    def mean_distance_error(self) -> float:
        """Expected mean absolute error of the distances between cameras, metres.

        A distance's error is normal to first order, and E|x| = σ √(2/π).
        """
        sigmas = []
        for i in range(len(self.cameras)):
            for j in range(i):
                along = self.places[i] - self.places[j]
                along = along / np.linalg.norm(along)
                gradient = np.zeros(len(self.covariance))
                gradient[6 * i : 6 * i + 3], gradient[6 * j : 6 * j + 3] = along, -along
                sigmas.append(np.sqrt(gradient @ self.covariance @ gradient))
        return float(np.mean(sigmas) * np.sqrt(2 / np.pi)) if sigmas else 0.0


def cramer_rao(
    data: DataSet, cameras: dict[str, Pose], places: list[tuple[Observation, Pose]]
) -> Bound:
    """The bound over true camera poses and observations with the robot's true pose at each.

    `data` gives site, targets, lenses and odometry; the odometry's noise is taken as the contract
    states it, with nothing added.
    """
    true_cameras = {
        n: CameraState(p, data.lenses[n]) for n, p in cameras.items() if n in data.lenses
    }
    first = data.first_state()
    entries = []
    for observation, map_from_base in places:
        if observation.camera in true_cameras:
            read = _read(data, observation, true_cameras[observation.camera], map_from_base)
            entries.append(Entry(read.judged(Verdict.ACCEPTED), map_from_base))
    oracle = DataSet(data.site, data.targets, data.lenses, data.known, dict(data.tracks), entries)
    for name, track in data.tracks.items():
        oracle.tracks[name] = _stated(track)
    state = State(true_cameras, first.robots)
    assembled = assemble(oracle, state, list(range(len(entries))))
    reduced = reduce(assembled.problem, linearise(assembled.problem, assembled.start))
    names = list(reduced.layout.pose)
    columns = np.concatenate(
        [np.arange(reduced.layout.size)[reduced.layout.pose[n]] for n in names]
    )
    covariance = reduced.covariance()[np.ix_(columns, columns)]
    return Bound(names, covariance, np.array([cameras[name].translation for name in names]))


def _read(
    data: DataSet, observation: Observation, camera: CameraState, map_from_base: Pose
) -> Observation:
    target = data.targets[observation.robot]
    camera_from_base = camera.map_from_camera.inverse() @ map_from_base
    return observation.read_as(
        tuple(best_reading(v, target, camera.lens, camera_from_base)[0] for v in observation.views)
    )


def _stated(track: OdometryTrack) -> OdometryTrack:
    stated = OdometryTrack(track.noise, planar=track.planar, slip=0.0)
    poses = track.odom_from_base
    for index, stamp_ns in enumerate(track.stamps_ns):
        stated.add(int(stamp_ns), poses[index])
    return stated
