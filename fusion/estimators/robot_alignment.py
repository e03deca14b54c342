"""The robot's pose by one sighting of a located camera, and the best reading of that sighting."""

import numpy as np
from msgspec.structs import replace

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.gates import DECISIVE
from trigpoint.fusion.model.observations import Observation
from trigpoint.fusion.reading.alignment import Alignment, PosePrior, align
from trigpoint.fusion.solver.filter import Filter, RobotEstimate
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array

# Added to the variances of a robot's pose relative to the camera, m² and rad².
_FLOOR_M2 = 0.05**2
_FLOOR_RAD2 = 0.05**2


def align_to(
    data: DataSet,
    observation: Observation,
    lens: CameraModel,
    map_from_camera: Pose,
    camera_covariance: Array,
    predicted: RobotEstimate | None,
) -> Alignment | None:
    """A located camera's observation in its best reading; None where nothing fits or two readings
    fit equally well. `camera_covariance` (6, 6): of the camera's pose; `predicted`: None where the
    robot's pose is not known."""
    prior, distance = None, 3.0
    if predicted is not None:
        prior = _prior(predicted)
        between = predicted.map_from_base.translation - map_from_camera.translation
        distance = float(np.linalg.norm(between))
    extra_sigma_px = camera_sigma_px(lens, camera_covariance, distance)
    return _aligned(data, observation, lens, map_from_camera, prior, extra_sigma_px)


def align_before(
    data: DataSet, known: Filter, observation: Observation, predicted: RobotEstimate
) -> Alignment | None:
    """`align_to` with the filter's own prediction for an observation's moment.

    Far from a wide map's origin, robot and camera are both uncertain, but correlated: the prior is
    then the robot's pose relative to the camera, which tells faces that look alike apart.
    """
    tangent = data.tracks[observation.robot].tangent
    camera = known.state.cameras[observation.camera]
    lens, map_from_camera = camera.lens, camera.map_from_camera
    if not _prior(predicted).is_tight(tangent):
        before = known.before(data, observation.robot, observation.camera, predicted.stamp_ns)
        floor = np.diag(np.repeat([_FLOOR_M2, _FLOOR_RAD2], 3))
        prior = _prior(replace(predicted, covariance=before + floor))
        if prior.is_tight(tangent):
            # An error that the robot's motion excludes (height, tilt) is taken to be the camera's.
            variances = np.where(np.isin(np.arange(6), tangent), 0.0, np.diagonal(before))
            between = predicted.map_from_base.translation - map_from_camera.translation
            turned = variances[3:].max() + variances[:3].max() / max(between @ between, 0.01)
            extra_sigma_px = float(lens.fx * np.sqrt(turned))
            return _aligned(data, observation, lens, map_from_camera, prior, extra_sigma_px)
    covariance = known.known.covariance_of(known.layout.pose[observation.camera])
    return align_to(data, observation, lens, map_from_camera, covariance, predicted)


def camera_sigma_px(lens: CameraModel, covariance: Array, distance_m: float) -> float:
    """By about how many pixels a camera's own uncertainty, of covariance (6, 6), moves what it sees
    at a distance."""
    variances = np.diagonal(covariance)
    turn, shift = variances[3:].max(), variances[:3].max() / max(distance_m, 0.1) ** 2
    return float(lens.fx * np.sqrt(turn + shift))


def _prior(predicted: RobotEstimate) -> PosePrior:
    return PosePrior(predicted.map_from_base, predicted.covariance + 1e-10 * np.eye(6))


def _aligned(
    data: DataSet,
    observation: Observation,
    lens: CameraModel,
    map_from_camera: Pose,
    prior: PosePrior | None,
    extra_sigma_px: float,
) -> Alignment | None:
    alignment = align(
        observation,
        data.targets[observation.robot],
        lens,
        map_from_camera,
        tangent=data.tracks[observation.robot].tangent,
        prior=prior,
        extra_sigma_px=extra_sigma_px,
    )
    return alignment if alignment is not None and alignment.margin >= DECISIVE else None
