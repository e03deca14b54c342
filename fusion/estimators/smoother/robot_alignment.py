"""The robot's pose by one sighting of a located camera, and which reading of it that needs."""

from dataclasses import replace

import numpy as np

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.gates import DECISIVE
from trigpoint.fusion.model.observations import Observation
from trigpoint.fusion.reading.alignment import PosePrior, align
from trigpoint.fusion.solver.filter import Filter, RobotEstimate
from trigpoint.geometry import Pose

# What a robot's place from the camera is taken to be uncertain by at the least, m² and rad².
_FLOOR_M2 = 0.05**2
_FLOOR_RAD2 = 0.05**2


def align_to(
    data: DataSet, known: Filter, observation: Observation, predicted: RobotEstimate | None
) -> tuple[Observation, Pose] | None:
    """A located camera's observation in its best reading, and the robot's pose by it; None where
    nothing fits or two readings fit equally well."""
    camera = known.state.cameras[observation.camera]
    prior, distance = None, 3.0
    if predicted is not None:
        prior = _prior(predicted)
        between = predicted.map_from_base.translation - camera.map_from_camera.translation
        distance = float(np.linalg.norm(between))
    return _aligned(
        data, known, observation, prior, known.camera_sigma_px(observation.camera, distance)
    )


def align_before(
    data: DataSet, known: Filter, observation: Observation, predicted: RobotEstimate
) -> tuple[Observation, Pose] | None:
    """The same for what the filter itself predicts of an observation's moment.

    Far from where a wide map began, robot and camera are both uncertain, but together: the prior is
    then where the robot is from the camera, which tells faces that look alike apart.
    """
    tangent = data.tracks[observation.robot].tangent
    if _prior(predicted).is_tight(tangent):
        return align_to(data, known, observation, predicted)
    before = known.before(data, observation.robot, observation.camera, predicted.stamp_ns)
    floor = np.diag(np.repeat([_FLOOR_M2, _FLOOR_RAD2], 3))
    prior = _prior(replace(predicted, covariance=before + floor))
    if not prior.is_tight(tangent):
        return align_to(data, known, observation, predicted)
    # What the robot cannot do, the camera does: it is off by height or tilt.
    variances = np.where(np.isin(np.arange(6), tangent), 0.0, np.diagonal(before))
    camera = known.state.cameras[observation.camera]
    between = predicted.map_from_base.translation - camera.map_from_camera.translation
    turned = variances[3:].max() + variances[:3].max() / max(between @ between, 0.01)
    return _aligned(data, known, observation, prior, float(camera.lens.fx * np.sqrt(turned)))


def _prior(predicted: RobotEstimate) -> PosePrior:
    return PosePrior(predicted.map_from_base, predicted.covariance + 1e-10 * np.eye(6))


def _aligned(
    data: DataSet,
    known: Filter,
    observation: Observation,
    prior: PosePrior | None,
    extra_sigma_px: float,
) -> tuple[Observation, Pose] | None:
    camera, robot = known.state.cameras[observation.camera], observation.robot
    alignment = align(
        observation,
        data.targets[robot],
        camera.lens,
        camera.map_from_camera,
        tangent=data.tracks[robot].tangent,
        prior=prior,
        extra_sigma_px=extra_sigma_px,
    )
    if alignment is None or alignment.margin < DECISIVE:
        return None
    return alignment.read(observation), alignment.map_from_base
