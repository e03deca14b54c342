"""What one sighting says by itself: how well a board fits it, and its score where it is wrong."""

import math
from dataclasses import dataclass, replace

import numpy as np

from trigpoint.fusion.model.observations import Observation, View, face_points
from trigpoint.fusion.model.projection import projected
from trigpoint.fusion.reading.planar_pose import planar_poses
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array
from trigpoint.target import Target

from .events import Events

_MOST_REFITS = 3
_MOST_WEIGHINGS = 6
_LEAST_GOOD = 4
_LEAST_CORNERS = 12


@dataclass(frozen=True, slots=True)
class Alone:
    """One view by itself.

    `wrong_score`: of a board that is somewhere else in its place; `evidence`: of its best fit, the
    pose integrated out; `scatter`: the corners' variance about that, over the stated one, without
    those that are wild by the median of their distances; NaN where they are too few; `wild`: which
    corners are, (n,).
    """

    wrong_score: float
    evidence: float
    scatter: float
    wild: np.ndarray


def alone(observation: Observation, order: int) -> Observation:
    """An observation of one of its views."""
    chosen = (observation.chosen[order],) if observation.chosen is not None else None
    return replace(observation, views=(observation.views[order],), chosen=chosen, outliers=())


def tamed(observation: Observation, views: tuple[Alone, ...]) -> Observation:
    """An observation without the corners that each of its views by itself shows to be wild."""
    if not any(np.any(view.wild) for view in views):
        return observation
    kept = []
    for view, by_itself in zip(observation.views, views, strict=True):
        good = ~by_itself.wild
        sweep = None if view.sweep is None else view.sweep.where(good)
        kept.append(
            replace(view, corners=view.corners[good], pixels=view.pixels[good], sweep=sweep)
        )
    return replace(observation, views=tuple(kept), outliers=())


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
        none = np.zeros(len(view.corners), dtype=bool)
        return Alone(events.pose_score + events.wrong_score, np.inf, np.nan, none)
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
    return Alone(wrong, evidence, scatter, wild)


def _fit(
    pose: Pose, points: Array, view: View, lens: CameraModel, events: Events
) -> tuple[Array, Array, np.ndarray]:
    """χ² of each corner about the pose that fits them (n,), the pose's information (6, 6), and
    which are wild."""
    wild = np.zeros(len(points), dtype=bool)
    jacobian, left = _linearised(pose, points, view, lens)
    for _ in range(_MOST_REFITS):
        step, wild = without_wild(jacobian, left, events.wild_score)
        pose = pose.disturbed(step)
        jacobian, left = _linearised(pose, points, view, lens)
    flat = jacobian[~wild].reshape(-1, 6)
    return np.sum(left**2, axis=1), flat.T @ flat, wild


def without_wild(by_pose: Array, residual: Array, limit: float) -> tuple[Array, np.ndarray]:
    """The step (6,) that corners' residuals (n, 2), in sigmas, ask for without the wild ones, and
    which are wild: beyond χ² of `limit` where Cauchy's weights leave the others.

    `by_pose`: (n, 2, 6).
    """
    weight = np.ones(len(residual))
    step = _step(by_pose, residual, weight)
    if np.all(np.sum((residual + by_pose @ step) ** 2, axis=1) <= limit):
        return step, weight == 0
    for _ in range(_MOST_WEIGHINGS):
        left = residual + by_pose @ _step(by_pose, residual, weight)
        square = np.sum(left**2, axis=1)
        weight = 1 / (1 + square / max(2.0, 2 * float(np.median(square))))
    for _ in range(_MOST_REFITS):
        left = residual + by_pose @ _step(by_pose, residual, weight)
        wild = np.sum(left**2, axis=1) > limit
        if np.sum(~wild) < _LEAST_GOOD:
            break  # it is no board, whatever it is
        if np.array_equal(weight, np.where(wild, 0.0, 1.0)):
            return _step(by_pose, residual, weight), wild
        weight = np.where(wild, 0.0, 1.0)
    if np.sum(weight > 0) < _LEAST_GOOD or np.any((weight > 0) & (weight < 1)):
        weight = np.ones(len(residual))
    return _step(by_pose, residual, weight), weight == 0


def _step(by_pose: Array, residual: Array, weight: Array) -> Array:
    root = np.sqrt(weight)[:, None]
    flat = (by_pose * root[..., None]).reshape(-1, 6)
    return np.linalg.lstsq(flat, -(residual * root).reshape(-1), rcond=1e-12)[0]


def _linearised(pose: Pose, points: Array, view: View, lens: CameraModel) -> tuple[Array, Array]:
    found = projected(lens, pose, points)
    return found.by_body / view.sigma, (found.pixels - view.pixels) / view.sigma
