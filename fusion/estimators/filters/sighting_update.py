"""How a filter uses one sighting: its reading, the robot's pose by it, and the gate on it."""

from trigpoint.fusion.estimators.robot_alignment import align_to
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.gates import is_noise
from trigpoint.fusion.model.observations import Observation
from trigpoint.fusion.model.problem import CameraState
from trigpoint.fusion.solver.filter import RobotEstimate, is_placed
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from .filter_state import FilterState, Innovation, ReadSighting
from .relative_pose import relative_view, without_wild_corners


def predicted_at(
    data: DataSet, before: FilterState, robot: str, time_ns: int
) -> tuple[FilterState, RobotEstimate | None]:
    """The filter state at a later time, and the robot there; None where its pose is not known."""
    if robot not in before.stamps_ns:
        return before, None
    filter_state = before.advanced(data, robot, time_ns)
    predicted = filter_state.robot(robot)
    if not is_placed(predicted.covariance):
        return before.without_robot(robot), None
    return filter_state, predicted


def read_sighting(
    data: DataSet,
    filter_state: FilterState,
    observation: Observation,
    predicted: RobotEstimate | None,
    variances: Array | None,
) -> ReadSighting | None:
    """The observation in its best reading; None where that is ambiguous or nothing fits.
    `variances`: see `ReadSighting`."""
    camera = filter_state.estimate(observation.camera)
    lens, map_from_camera = camera.lens, camera.map_from_camera
    alignment = align_to(data, observation, lens, map_from_camera, camera.covariance, predicted)
    if alignment is None:
        return None
    read = alignment.read(observation)
    pose = map_from_camera.inverse() @ alignment.map_from_base
    sound = without_wild_corners(read, data.targets[observation.robot], lens, pose)
    if sound is None:
        return None
    return ReadSighting(sound, alignment.map_from_base, variances, places_robot=predicted is None)


def first_sighting(
    data: DataSet,
    observation: Observation,
    camera: CameraState,
    map_from_base: Pose,
    variances: Array | None,
) -> ReadSighting | None:
    """The sighting by which a camera enters that all of its sightings located; None where it
    contradicts them. `variances`: see `ReadSighting`."""
    lens, target = camera.lens, data.targets[observation.robot]
    pose = camera.map_from_camera.inverse() @ map_from_base
    sound = without_wild_corners(observation, target, lens, pose)
    view = relative_view(sound, target, lens, pose, variances) if sound is not None else None
    if sound is None or view is None:
        return None
    if not is_noise(float(view.residual @ view.residual), len(view.residual)):
        return None
    return ReadSighting(sound, map_from_base, variances)


def is_expected(innovation: Innovation) -> bool:
    """Whether an innovation passes the χ² gate (normalised innovation squared)."""
    return innovation.freedom == 0 or is_noise(innovation.chi2, innovation.freedom)
