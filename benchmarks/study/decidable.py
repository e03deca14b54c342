"""Whether a camera's pictures decide where it is, asked by who knows the truth.

An estimator that says «undetermined» is right where another pose explains what the camera saw as
well as the true one does. Studies ask here, so that they count it as a fault only where it is one.
"""

from dataclasses import replace

import numpy as np

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.gates import DECISIVE
from trigpoint.geometry import Pose

from .hypotheses.camera_hypotheses import Hypothesis, distinct, refine
from .hypotheses.start_poses import spread, starts_of

_MOST_OBSERVATIONS = 24
_MOST_RIVALS = 24


def data_decide(data: DataSet, camera: str, true_pose: Pose, true_places: list[Pose]) -> bool:
    """Whether the true pose fits a camera's observations better than every other by 25 of χ²."""
    return lead_of_truth(data, camera, true_pose, true_places) >= DECISIVE


def lead_of_truth(data: DataSet, camera: str, true_pose: Pose, true_places: list[Pose]) -> float:
    """χ² by which the best other pose of a camera is worse than the one near the true one, both
    worked out to their best; infinite where there is no other, negative where another is better.

    `true_places`: map_from_base at each of the data set's entries. By the robot that tells most;
    poses below the floor are no others.
    """
    entries = [
        replace(entry, map_from_base=pose)
        for entry, pose in zip(data.entries, true_places, strict=True)
    ]
    known = DataSet(data.site, data.targets, data.lenses, data.known, data.tracks, entries)
    robots = {e.observation.robot for e in entries if e.observation.camera == camera}
    leads = [_lead(known, camera, robot, true_pose) for robot in sorted(robots)]
    return max(leads, default=-np.inf)


def _lead(data: DataSet, camera: str, robot: str, true_pose: Pose) -> float:
    indices = [
        index
        for index, entry in enumerate(data.entries)
        if (entry.observation.camera, entry.observation.robot) == (camera, robot)
    ]
    few, state = spread(indices, _MOST_OBSERVATIONS), data.first_state()
    truth = refine(data, state, camera, true_pose, few)
    if truth is None:
        return -np.inf
    starts = starts_of(data, camera, few, most=_MOST_RIVALS)
    rivals = distinct(refine(data, state, camera, start, few) for start in starts)
    return min(
        (truth.lead(rival) for rival in rivals if _is_other(data, truth, rival)), default=np.inf
    )


def _is_other(data: DataSet, truth: Hypothesis, rival: Hypothesis) -> bool:
    return not rival.is_like(truth) and not _is_below_floor(data, rival)


def _is_below_floor(data: DataSet, hypothesis: Hypothesis) -> bool:
    """Whether a camera would look up through the floor at robots that drive on it."""
    robots = {data.entries[index].observation.robot for index in hypothesis.located.readings}
    is_on_floor = all(data.tracks[robot].planar for robot in robots)
    return is_on_floor and hypothesis.located.map_from_camera.translation[2] < 0
