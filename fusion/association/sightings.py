"""What one sighting says by itself: how well a board fits it, and its score where it is wrong."""

import math
from dataclasses import dataclass, replace

import numpy as np

from trigpoint.fusion.observations import Observation, View, face_points
from trigpoint.fusion.planar_pose import planar_poses
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.rotation import Array
from trigpoint.target import Target

from .events import Events

_MOST_REFITS = 3
_LEAST_CORNERS = 12


@dataclass(frozen=True, slots=True)
class Alone:
    """One view by itself.

    `wrong_score`: of a board that is somewhere else in its place; `evidence`: of its best fit, the
    pose integrated out; `scatter`: the corners' variance about that, over the stated one, without
    those that are wild by the median of their distances; NaN where they are too few.
    """

    wrong_score: float
    evidence: float
    scatter: float


def alone(observation: Observation, order: int) -> Observation:
    """An observation of one of its views."""
    chosen = (observation.chosen[order],) if observation.chosen is not None else None
    return replace(observation, views=(observation.views[order],), chosen=chosen, outliers=())


def by_itself(
    observation: Observation, order: int, target: Target, lens: CameraModel, events: Events
) -> Alone:
    """One view's own fit; where no board fits at all, it is wrong and tells nothing."""
    view = observation.views[order]
    reading = view.readings[0]  # every other one shows the same board
    face = target.faces[reading.face]
    points = face_points(face, view.corners, is_turned=reading.is_turned)
    if view.sweep is not None:
        base_from_face = face.base_from_face
        points = points + view.sweep.shift(base_from_face @ points) @ base_from_face.rotation
    flat = face_points(face, view.corners, is_turned=reading.is_turned)
    fits = planar_poses(lens, flat, view.pixels, view.sigma)
    if not fits:
        return Alone(events.pose_score + events.wrong_score, np.inf, np.nan)
    left, normal, wild = _fit(fits[0].pose, points, view, lens, events)
    evidence = float(np.sum(left[~wild])) + int(wild.sum()) * events.wild_score
    evidence += float(np.linalg.slogdet(normal)[1])
    wrong = evidence + events.pose_score + events.wrong_score
    scatter = np.nan
    if len(points) >= _LEAST_CORNERS:
        # Half of all distances from the mean are beyond √(2 ln 2) σ; the fit takes three corners.
        share = 1 - 3 / len(points)
        middle = float(np.median(left)) / (2 * math.log(2) * share)
        kept = left[left < events.wild_score * middle]
        scatter = float(np.mean(kept)) / (2 * share)
    return Alone(wrong, evidence, scatter)


def _fit(
    pose: Pose, points: Array, view: View, lens: CameraModel, events: Events
) -> tuple[Array, Array, np.ndarray]:
    """χ² of each corner about the pose that fits them (n,), the pose's information (6, 6), and
    which are wild."""
    wild = np.zeros(len(points), dtype=bool)
    normal, left = np.eye(6), np.zeros((len(points), 2))
    for _ in range(_MOST_REFITS):
        for _ in range(2):
            jacobian, residual = _linearised(pose, points, view, lens)
            flat = jacobian[~wild].reshape(-1, 6)
            normal = flat.T @ flat
            step = np.linalg.lstsq(flat, -residual[~wild].reshape(-1), rcond=1e-12)[0]
            pose = pose.disturbed(step)
        left = _linearised(pose, points, view, lens)[1]
        again = np.sum(left**2, axis=1) > events.wild_score
        if np.array_equal(again, wild) or np.sum(~again) < 4:
            break
        wild = again
    return np.sum(left**2, axis=1), normal, wild


def _linearised(pose: Pose, points: Array, view: View, lens: CameraModel) -> tuple[Array, Array]:
    arm = points @ pose.rotation.T
    optical = arm + pose.translation
    optical[:, 2] = np.maximum(optical[:, 2], 1e-2)
    projected, by_point = lens.project_by_point(optical)
    jacobian = np.concatenate([by_point, -by_point @ so3.hat(arm)], axis=-1) / view.sigma
    return jacobian, (projected - view.pixels) / view.sigma
