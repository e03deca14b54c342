"""A robot at a place of a known network, seen by its cameras once: what fusion's filter makes of
that, where the cameras stand a little otherwise than the network says."""

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.contract.messages import FaceSighting
from trigpoint.fusion.coverage.known_network import KnownNetwork
from trigpoint.fusion.estimators.robot_alignment import align_to
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.observations import Observation, observation_of, view_of
from trigpoint.fusion.model.problem import CameraState
from trigpoint.fusion.reading.sight import Eye
from trigpoint.fusion.solver.filter import Filter, RobotEstimate
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import planar_covariance
from trigpoint.site.target import Target
from trigpoint.tools.simulation.session import EPOCH_NS
from trigpoint.tools.simulation.sight.seen_corners import seen_faces_each

SMALLEST_SQUARE_PX = 7.0  # of a world file
_ROUGHLY = np.array([0.1, 0.1, 0.05])  # what odometry knows beforehand, m and rad


class Corrector(Struct, frozen=True, eq=False):
    """Fusion's filter with a network that is known. `robot`: the one that is corrected."""

    data: DataSet
    network: KnownNetwork
    robot: str

    @property
    def target(self) -> Target:
        return self.data.targets[self.robot]

    def corrected(
        self,
        map_from_base: Pose,
        sighted: dict[str, tuple[FaceSighting, ...]],
        random: np.random.Generator,
    ) -> Pose | None:
        """Where the filter has the robot after these sightings; None where it uses none."""
        said = planar_covariance(np.diag(_ROUGHLY**2))
        about = np.zeros(6)
        about[[0, 1, 5]] = random.normal(0.0, _ROUGHLY)
        predicted = RobotEstimate(EPOCH_NS, map_from_base.disturbed(about), said)
        current: Filter | None = None
        for number, eye in enumerate(self.network.eyes):
            observation = self._observation(eye, sighted.get(eye.name, ()))
            if observation is None:
                continue
            own = self.network.covariance[6 * number : 6 * number + 6, 6 * number : 6 * number + 6]
            aligned = align_to(
                self.data, observation, eye.lens, eye.map_from_camera, own, predicted
            )
            if aligned is None:
                continue
            if current is None:
                current = self._before(aligned.map_from_base)
            current, _ = current.updated(self.data, aligned.read(observation))
        return None if current is None else current.robot(self.data, self.robot).map_from_base

    def _observation(self, eye: Eye, faces: tuple[FaceSighting, ...]) -> Observation | None:
        config = self.data.site.cameras[eye.name]
        views = [view_of(self.target, face, config) for face in faces]
        kept = tuple(view for view in views if view is not None)
        return observation_of(eye.name, self.robot, EPOCH_NS, kept) if kept else None

    def _before(self, guess: Pose) -> Filter:
        """The filter of a robot that may be anywhere, which also tells of the cameras."""
        cameras = {e.name: CameraState(e.map_from_camera, e.lens) for e in self.network.eyes}
        known, place = self.network.covariance, (EPOCH_NS, guess, np.zeros(2))
        fixed = Filter.in_fixed_map(self.data, cameras, known, self.robot, *place)
        return replace(fixed, holds_cameras=False)


def sightings(
    target: Target,
    map_from_base: Pose,
    eyes: tuple[Eye, ...],
    errors: Array,
    sigma_px: float,
    random: np.random.Generator,
) -> list[dict[str, tuple[FaceSighting, ...]]]:
    """What a good detector finds of a robot at poses (n) in one picture of each camera, where each
    of the m cameras truly stands off by `errors` (n, m, 6) from where it is thought to be."""
    found: list[dict[str, tuple[FaceSighting, ...]]] = [{} for _ in range(len(map_from_base))]
    for number, eye in enumerate(eyes):
        true_poses = eye.map_from_camera.repeated(len(errors)).disturbed(errors[:, number])
        # What a camera sees depends on where the robot is before it, so that is what is moved.
        seen_from_there = eye.map_from_camera @ (true_poses.inverse() @ map_from_base)
        each = seen_faces_each(target, seen_from_there, eye.map_from_camera, eye.lens, ())
        for row, faces in enumerate(each):
            shown = tuple(
                seen.sighting(
                    target,
                    "",
                    seen.pixels + random.normal(0.0, sigma_px, seen.pixels.shape),
                    sigma_px,
                )
                for seen in faces
                if seen.is_found(SMALLEST_SQUARE_PX)
            )
            if shown:
                found[row][eye.name] = shown
    return found
