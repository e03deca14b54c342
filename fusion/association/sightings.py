"""What one sighting says by itself: how well a board fits it, its wild (outlier) corners, and its
score if it is wrong."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from trigpoint.fusion.model.observations import Observation, View, face_points, swept
from trigpoint.fusion.model.projection import projected
from trigpoint.fusion.reading.best_readings import groups_of
from trigpoint.fusion.reading.planar_pose import planar_poses
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array
from trigpoint.site.target import Target

from .events import Events

_MOST_REFITS = 3
_MOST_WEIGHINGS = 6
_LEAST_GOOD = 4
_LEAST_CORNERS = 12
# Share of the information that is added to it: keeps a direction that no corner shows solvable.
_OPEN = 1e-14
_LEAST = 1e-14


@dataclass(frozen=True, slots=True)
class Alone:
    """What one view says by itself.

    `wrong_score`: the score if the view is wrong, of a board that is somewhere else; `evidence`:
    the score of the best fit, the pose integrated out; `scatter`: the corners' variance about that
    fit over the stated one, without corners that are wild by the median distance; NaN where there
    are too few corners; `wild`: flags of the wild corners, (n,).
    """

    wrong_score: float
    evidence: float
    scatter: float
    wild: np.ndarray


def alone(observation: Observation, order: int) -> Observation:
    """The observation with only one of its views."""
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
    """Fit one view by itself; where no board fits at all, the view is wrong and tells nothing.

    A flat board has two poses that look much alike, and wild corners may make the wrong one of them
    the better start, or spoil both. So where any corner is wild, every start is fitted, those from
    the corners that one homography maps too, and the best fit counts.
    """
    fit = _best_fit(view, lens, target, events)
    if fit is None:
        return Alone(events.wrong_limit, np.inf, np.nan, np.zeros(len(view.corners), dtype=bool))
    score, left, wild = fit
    scatter = np.nan
    if len(left) >= _LEAST_CORNERS:
        # Half of all distances from the mean are beyond √(2 ln 2) σ; the fit takes three corners.
        share = 1 - 3 / len(left)
        middle = float(np.median(left)) / (2 * math.log(2) * share)
        kept = left[left < events.wild_score * middle]
        scatter = float(np.mean(kept)) / (2 * share)
    return Alone(score + events.wrong_limit, score, scatter, wild)


def _best_fit(
    view: View, lens: CameraModel, target: Target, events: Events
) -> tuple[float, Array, np.ndarray] | None:
    """Return the best of `_fit` from every start; None where there is none."""
    reading = view.readings[0]  # every other reading is of the same board
    face = target.faces[reading.face]
    flat = face_points(face, view.corners, is_turned=reading.is_turned)
    points = swept(flat, view, face)
    starts = planar_poses(lens, flat, view.pixels, view.sigma)
    tried = [_fit(start.pose, points, view, lens, events) for start in starts[:1]]
    if tried and np.all(tried[0][1] < events.wild_score):
        return tried[0]
    in_plane = _on_one_plane(flat, view.pixels, lens, math.sqrt(events.wild_score) * view.sigma)
    if not np.all(in_plane):
        starts += planar_poses(lens, flat[in_plane], view.pixels[in_plane], view.sigma)
    tried += [_fit(start.pose, points, view, lens, events) for start in starts[len(tried) :]]
    return min(tried, key=_score, default=None)


def _score(fit: tuple[float, Array, np.ndarray]) -> float:
    """The score of a fit; infinite where it diverged."""
    return fit[0] if np.isfinite(fit[0]) else np.inf


def _on_one_plane(flat: Array, pixels: Array, lens: CameraModel, limit: float) -> np.ndarray:
    """Which corners (n,) the homography that fits most of them maps to within `limit` (pixels)
    of where they are; all where there is none."""
    directions = lens.directions(pixels)
    if len(flat) <= _LEAST_GOOD or not np.all(np.isfinite(directions)):
        return np.ones(len(flat), dtype=bool)
    _, mask = cv2.findHomography(flat[:, :2], directions, cv2.RANSAC, limit / lens.fx)
    return np.ones(len(flat), dtype=bool) if mask is None else mask.ravel().astype(bool)


def _fit(
    pose: Pose, points: Array, view: View, lens: CameraModel, events: Events
) -> tuple[float, Array, np.ndarray]:
    """Fit the pose, and return the score of the fit with the pose integrated out, each corner's χ²
    about it (n,), and which corners are wild (n,)."""
    wild = np.zeros(len(points), dtype=bool)
    jacobian, left = _linearised(pose, points, view, lens)
    for _ in range(_MOST_REFITS):
        (step,), (wild,) = all_without_wild(jacobian[None], left[None], events.wild_score)
        pose = pose.disturbed(step)
        jacobian, left = _linearised(pose, points, view, lens)
    flat = jacobian[~wild].reshape(-1, 6)
    chi2 = np.sum(left**2, axis=1)
    score = float(np.sum(chi2[~wild])) + int(wild.sum()) * events.wild_score
    return score + float(np.linalg.slogdet(flat.T @ flat)[1]), chi2, wild


def wild_corners(sightings: Sequence[tuple[Array, Array]], limit: float) -> list[np.ndarray]:
    """Flags (n,) of each sighting's wild corners, from its derivatives (n, 2, 6) and residuals
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
    """For sightings (v) with equally many corners (n), each by itself: the least-squares steps
    (v, 6) of the pose without the wild corners, and which corners are wild (v, n): those whose χ²
    exceeds `limit` about a fit that starts from Cauchy weights.

    `by_pose`: (v, n, 2, 6); `residual`: (v, n, 2), in sigmas.
    """
    weight = np.ones(residual.shape[:2])
    step, square = _steps(by_pose, residual, weight)
    rows = np.flatnonzero(np.any(square > limit, axis=1))
    if len(rows):
        weight[rows] = _weights(by_pose[rows], residual[rows], limit)
        step[rows], _ = _steps(by_pose[rows], residual[rows], weight[rows])
    return step, weight == 0


def _weights(by_pose: Array, residual: Array, limit: float) -> Array:
    """Corner weights (v, n) of sightings that may have wild corners: 0 for those, else 1; all 1
    where no such choice settles."""
    weight = np.ones(residual.shape[:2])
    for _ in range(_MOST_WEIGHINGS):
        _, square = _steps(by_pose, residual, weight)
        middle = np.median(square, axis=1, keepdims=True)
        weight = 1 / (1 + square / np.maximum(2.0, 2 * middle))
    for _ in range(_MOST_REFITS):
        _, square = _steps(by_pose, residual, weight)
        is_good = square <= limit
        is_board = np.sum(is_good, axis=1) >= _LEAST_GOOD  # fewer good corners are no board
        weight = np.where(is_board[:, None], is_good, weight)
    is_settled = np.all((weight == 0) | (weight == 1), axis=1)
    is_settled &= np.sum(weight > 0, axis=1) >= _LEAST_GOOD
    return np.where(is_settled[:, None], weight, 1.0)


def _steps(by_pose: Array, residual: Array, weight: Array) -> tuple[Array, Array]:
    """Weighted least-squares steps (v, 6), with a weight for each corner (v, n), and the χ² (v, n)
    that they leave of every corner."""
    flat = by_pose.reshape(len(by_pose), -1, 6)
    weighted = np.swapaxes((by_pose * weight[..., None, None]).reshape(flat.shape), 1, 2)
    normal = weighted @ flat
    # Collinear corners leave a direction undetermined; the step along it is zero.
    normal += _OPEN * np.eye(6) * np.diagonal(normal, axis1=1, axis2=2)[:, None] + _LEAST * np.eye(
        6
    )
    step = -np.linalg.solve(normal, weighted @ residual.reshape(len(flat), -1, 1))
    left = residual + (flat @ step).reshape(residual.shape)
    return step[..., 0], np.sum(left**2, axis=-1)


def _linearised(pose: Pose, points: Array, view: View, lens: CameraModel) -> tuple[Array, Array]:
    found = projected(lens, pose, points)
    return found.by_body / view.sigma, (found.pixels - view.pixels) / view.sigma
