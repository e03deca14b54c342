"""What one sighting says by itself: how well a board fits it, and its score where it is wrong."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from trigpoint.fusion.model.observations import Observation, View, face_points, swept
from trigpoint.fusion.model.projection import projected
from trigpoint.fusion.reading.best_readings import groups_of
from trigpoint.fusion.reading.planar_pose import planar_poses
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array
from trigpoint.target import Target

from .events import Events

_MOST_REFITS = 3
_MOST_WEIGHINGS = 6
_LEAST_GOOD = 4
_LEAST_CORNERS = 12
# Of its information: what keeps a direction that no corner shows solvable.
_OPEN = 1e-14
_LEAST = 1e-14


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


def by_itself(view: View, lens: CameraModel, target: Target, events: Events) -> Alone:
    """One view's own fit; where no board fits at all, it is wrong and tells nothing."""
    reading = view.readings[0]  # every other one shows the same board
    face = target.faces[reading.face]
    flat = face_points(face, view.corners, is_turned=reading.is_turned)
    fits = planar_poses(lens, flat, view.pixels, view.sigma)
    if not fits:
        return Alone(events.wrong_limit, np.inf, np.nan, np.zeros(len(view.corners), dtype=bool))
    points = swept(flat, view, face)
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
        (step,), (wild,) = all_without_wild(jacobian[None], left[None], events.wild_score)
        pose = pose.disturbed(step)
        jacobian, left = _linearised(pose, points, view, lens)
    flat = jacobian[~wild].reshape(-1, 6)
    return np.sum(left**2, axis=1), flat.T @ flat, wild


def wild_corners(sightings: Sequence[tuple[Array, Array]], limit: float) -> list[np.ndarray]:
    """Which corners (n,) of sightings are wild, each by its derivatives (n, 2, 6) and residuals
    (n, 2)."""
    found = [np.zeros(0, dtype=bool)] * len(sightings)
    for rows in groups_of([len(residual) for _, residual in sightings]):
        by_pose, residual = (
            np.stack(each) for each in zip(*(sightings[r] for r in rows), strict=True)
        )
        _, wild = all_without_wild(by_pose, residual, limit)
        for row, flags in zip(rows.tolist(), wild, strict=True):
            found[row] = flags
    return found


def all_without_wild(by_pose: Array, residual: Array, limit: float) -> tuple[Array, np.ndarray]:
    """Of sightings (v) with equally many corners (n), each by itself: the steps (v, 6) that the
    residuals (v, n, 2), in sigmas, ask for without the wild corners, and which are wild (v, n):
    beyond χ² of `limit` where Cauchy's weights leave the others.

    `by_pose`: (v, n, 2, 6).
    """
    weight = np.ones(residual.shape[:2])
    step, square = _steps(by_pose, residual, weight)
    rows = np.flatnonzero(np.any(square > limit, axis=1))
    if len(rows):
        weight[rows] = _weights(by_pose[rows], residual[rows], limit)
        step[rows], _ = _steps(by_pose[rows], residual[rows], weight[rows])
    return step, weight == 0


def _weights(by_pose: Array, residual: Array, limit: float) -> Array:
    """Of sightings of which some corners may be wild, 0 for those that are, (v, n)."""
    weight = np.ones(residual.shape[:2])
    for _ in range(_MOST_WEIGHINGS):
        _, square = _steps(by_pose, residual, weight)
        middle = np.median(square, axis=1, keepdims=True)
        weight = 1 / (1 + square / np.maximum(2.0, 2 * middle))
    for _ in range(_MOST_REFITS):
        _, square = _steps(by_pose, residual, weight)
        is_good = square <= limit
        is_board = np.sum(is_good, axis=1) >= _LEAST_GOOD  # otherwise whatever it is
        weight = np.where(is_board[:, None], is_good, weight)
    is_settled = np.all((weight == 0) | (weight == 1), axis=1)
    is_settled &= np.sum(weight > 0, axis=1) >= _LEAST_GOOD
    return np.where(is_settled[:, None], weight, 1.0)


def _steps(by_pose: Array, residual: Array, weight: Array) -> tuple[Array, Array]:
    """The steps (v, 6) of least squares with corners weighed (v, n), and what each leaves of every
    corner, χ² (v, n)."""
    flat = by_pose.reshape(len(by_pose), -1, 6)
    weighted = np.swapaxes((by_pose * weight[..., None, None]).reshape(flat.shape), 1, 2)
    normal = weighted @ flat
    # Corners in one row leave a direction open; along it nothing is asked for.
    normal += _OPEN * np.eye(6) * np.diagonal(normal, axis1=1, axis2=2)[:, None] + _LEAST * np.eye(
        6
    )
    step = -np.linalg.solve(normal, weighted @ residual.reshape(len(flat), -1, 1))
    left = residual + (flat @ step).reshape(residual.shape)
    return step[..., 0], np.sum(left**2, axis=-1)


def _linearised(pose: Pose, points: Array, view: View, lens: CameraModel) -> tuple[Array, Array]:
    found = projected(lens, pose, points)
    return found.by_body / view.sigma, (found.pixels - view.pixels) / view.sigma
