"""Lays a solved map over surveyed points: where it is in the building, how surely, and which points
contradict the others.

Weighted least squares over a rigid transform. A point's residual is held against its own covariance
by that adjustment (Baarda's test of single points): one that even so is beyond chance is an
outlier, and the largest set of points that agree decides which ones are.
"""

import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np
from msgspec import Struct

from trigpoint.base.errors import InputError
from trigpoint.geometry import Pose
from trigpoint.geometry.chi_square import chi2_limit, chi2_tail
from trigpoint.geometry.rotation import Array, about_z, hat

_CHANCE = 1e-3
"""That in a survey without a mistake any point is called an outlier."""
_LARGEST_TURN_SIGMA = 0.1
"""rad: at more than this the points do not tell a direction, nor does its linearisation hold."""
_MOST_STARTS = 1000
"""With half of the points wrong, one start in eight is sound: none in a thousand never happens."""
_ROUNDS = 20
_ROUNDING = 1e-6


class SurveyedPoint(Struct, frozen=True, eq=False):
    """One point: in the map (3,), in the building's frame (2,) or (3,) where its height is known
    too, metres; `sigma_m`: of each of the latter's coordinates."""

    name: str
    in_map: Array
    in_frame: Array
    sigma_m: float


class Residual(Struct, frozen=True, eq=False):
    """What a point is off, surveyed minus map, (2,) or (3,) metres in the building's frame; χ²; the
    probability of as much by chance; whether it was left out as an outlier."""

    name: str
    offset_m: Array
    chi2: float
    probability: float
    is_outlier: bool

    @property
    def distance_m(self) -> float:
        return float(np.linalg.norm(self.offset_m))


class Laying(Struct, frozen=True, eq=False):
    """`frame_from_map` with its `covariance` (6, 6) by the contract; each point's residual.

    `gains`: by point (6, 3), the transform's disturbance by an error of the point in the map;
    `survey_covariance` (6, 6): the part of `covariance` that is the survey's own.
    """

    frame_from_map: Pose
    covariance: Array
    residuals: tuple[Residual, ...]
    gains: tuple[Array, ...]
    survey_covariance: Array

    @property
    def outliers(self) -> list[str]:
        return [one.name for one in self.residuals if one.is_outlier]


class _Fit(Struct, frozen=True, eq=False):
    """The transform by some of the points; `gain` (6, 3n): its disturbance by each coordinate's
    error, surveyed minus map."""

    frame_from_map: Pose
    gain: Array
    covariance: Array


def lay(points: Sequence[SurveyedPoint], covariance: Array, *, is_level: bool) -> Laying:
    """The transform that lays the map over the points; `covariance` (3n, 3n): of their positions in
    the map.

    `is_level`: both have z up, so that two points are enough; else three, not in a line. Raises
    InputError where there are too few, where they do not tell a direction, and where they
    contradict each other without a majority.
    """
    fewest = 2 if is_level else 3
    if len(points) < fewest:
        raise InputError(
            f"{len(points)} surveyed points are located in the map; {fewest} are needed to lay it "
            "over the building"
        )
    survey = _Survey(points, covariance, is_level)
    used = survey.agreeing(fewest)
    fit = survey.fit(used)
    if fit is None:
        raise InputError(
            f"the surveyed points {_names(points)} do not tell the map's direction; survey points "
            "that are further apart" + ("" if is_level else " and not in a line")
        )
    return survey.laying(fit, used)


def _names(points: Sequence[SurveyedPoint]) -> str:
    return ", ".join(point.name for point in points)


class _Survey:
    """The adjustment's fixed parts. A point has three rows; the third is without weight where no
    height was surveyed."""

    def __init__(self, points: Sequence[SurveyedPoint], covariance: Array, is_level: bool) -> None:
        self._points, self._covariance, self._is_level = points, covariance, is_level
        self._in_map = np.array([point.in_map for point in points])
        self._in_frame = np.array([np.resize(point.in_frame, 3) for point in points])
        self._known = np.array(
            [[True, True, len(point.in_frame) == 3] for point in points]
        ).reshape(-1)
        variances = np.repeat([point.sigma_m**2 for point in points], 3)
        self._survey = np.diag(variances)
        count = len(points)
        blocks = np.arange(count)
        self._own = covariance.reshape(count, 3, count, 3)[blocks, :, blocks]
        self._own_survey = variances.reshape(count, 3, 1) * np.eye(3)
        has_height = any(len(point.in_frame) == 3 for point in points)
        unknowns = [0, 1, 2, 5] if has_height else [0, 1, 5]
        self._unknowns = unknowns if is_level else list(range(6))

    def agreeing(self, fewest: int) -> list[int]:
        """The numbers of the points that agree: all, or the most that do around the best start."""
        everyone = list(range(len(self._points)))
        if self._agrees(everyone):
            return everyone
        chosen = self._around_best_start(fewest)
        for _ in range(_ROUNDS):
            fit = self.fit(chosen) if len(chosen) >= fewest else None
            if fit is None:
                break
            agreeing = [i for i in everyone if not self._residual(fit, i).is_outlier]
            if agreeing == chosen:
                break
            chosen = agreeing
        is_majority = len(chosen) > fewest and 2 * len(chosen) > len(everyone)
        if not is_majority or not self._agrees(chosen):
            raise InputError(self._contradiction(everyone))
        return chosen

    def _around_best_start(self, fewest: int) -> list[int]:
        """The points near to where the best of some smallest sets puts them, which is the one with
        the least sum of χ², each no larger than the limit. χ² is by the point's own covariance: by
        that of a bad start, which leaves the rest open, everything would agree."""
        count = len(self._points)
        limit = chi2_limit(3, _CHANCE / count)
        best: tuple[float, list[int]] = (math.inf, [])
        for start in _starts(count, fewest):
            pose = self._start(list(start))
            if pose is not None:
                chi2 = self._own_chi2(pose)
                score = float(np.minimum(chi2, limit).sum())
                if score < best[0]:
                    best = score, np.flatnonzero(chi2 <= limit).tolist()
        return best[1]

    def _own_chi2(self, pose: Pose) -> Array:
        """(n,) of the points' offsets by their own covariances alone."""
        known = self._known.reshape(-1, 3)
        offsets = np.where(known, self._offsets(pose), 0.0)
        own = pose.rotation @ self._own @ pose.rotation.T + self._own_survey
        return np.einsum("ni,ni->n", offsets, np.linalg.solve(own, offsets[..., None])[..., 0])

    def fit(self, numbers: list[int]) -> _Fit | None:
        """By these points; None where they do not tell the transform."""
        rows = [3 * i + axis for i in numbers for axis in range(3) if self._known[3 * i + axis]]
        pose = self._start(numbers)
        found = None
        for _ in range(_ROUNDS):
            found = self._linearised(pose, rows) if pose is not None else None
            if pose is None or found is None:
                return None
            gain, _ = found
            step = gain[:, rows] @ self._offsets(pose).reshape(-1)[rows]
            pose = pose.disturbed(step)
            if np.linalg.norm(step) < _ROUNDING**2:
                break
        if pose is None or found is None:
            return None
        gain, covariance = found
        if math.sqrt(float(np.max(np.diagonal(covariance)[3:]))) > _LARGEST_TURN_SIGMA:
            return None
        return _Fit(pose, gain, covariance)

    def _linearised(self, pose: Pose, rows: list[int]) -> tuple[Array, Array] | None:
        """Gain (6, 3n) and covariance (6, 6) of the transform by these rows; None where they leave
        something of it open."""
        derivative = self._derivative(pose)[np.ix_(rows, self._unknowns)]
        weighted = np.linalg.solve(self._spread(pose)[np.ix_(rows, rows)], derivative).T
        information = weighted @ derivative
        if np.linalg.cond(information) > 1 / np.finfo(float).eps:
            return None
        inverse = np.linalg.inv(information)
        gain, covariance = np.zeros((6, len(self._known))), np.zeros((6, 6))
        gain[np.ix_(self._unknowns, rows)] = inverse @ weighted
        covariance[np.ix_(self._unknowns, self._unknowns)] = inverse
        return gain, covariance

    def laying(self, fit: _Fit, used: list[int]) -> Laying:
        rotation = fit.frame_from_map.rotation
        tested = [self._residual(fit, number) for number in range(len(self._points))]
        residuals = tuple(
            Residual(one.name, one.offset_m, one.chi2, one.probability, number not in used)
            for number, one in enumerate(tested)
        )
        gains = tuple(-fit.gain[:, 3 * i : 3 * i + 3] @ rotation for i in range(len(tested)))
        survey = fit.gain @ self._survey @ fit.gain.T
        return Laying(fit.frame_from_map, fit.covariance, residuals, gains, survey)

    def _agrees(self, numbers: list[int]) -> bool:
        """Whether no point of these is beyond chance in their own adjustment."""
        fit = self.fit(numbers)
        return fit is None or not any(self._residual(fit, i).is_outlier for i in numbers)

    def _residual(self, fit: _Fit, number: int) -> Residual:
        """A point's residual against its covariance, whether or not it is one of the fit's."""
        rows = [3 * number + axis for axis in range(3) if self._known[3 * number + axis]]
        offset = self._offsets(fit.frame_from_map).reshape(-1)[rows]
        shown = -self._derivative(fit.frame_from_map) @ fit.gain
        shown = (shown + np.eye(len(shown)))[rows]
        spread = shown @ self._spread(fit.frame_from_map) @ shown.T
        values, axes = np.linalg.eigh(spread)
        own = self._points[number].sigma_m ** 2
        telling = values > _ROUNDING * max(own, float(values[-1]))
        chi2 = float(np.sum((axes.T @ offset)[telling] ** 2 / values[telling]))
        probability = chi2_tail(int(telling.sum()), chi2)
        is_outlier = probability < _CHANCE / len(self._points)
        return Residual(self._points[number].name, offset, chi2, probability, is_outlier)

    def _offsets(self, pose: Pose) -> Array:
        """(n, 3), surveyed minus map."""
        return self._in_frame - pose @ self._in_map

    def _derivative(self, pose: Pose) -> Array:
        """(3n, 6) of the points in the frame by the contract's disturbance of the transform."""
        turned = self._in_map @ pose.rotation.T
        return np.concatenate([np.hstack([np.eye(3), -hat(one)]) for one in turned])

    def _spread(self, pose: Pose) -> Array:
        """(3n, 3n) of surveyed minus map."""
        turn = np.kron(np.eye(len(self._points)), pose.rotation)
        return turn @ self._covariance @ turn.T + self._survey

    def _start(self, numbers: list[int]) -> Pose | None:
        """Without weights (Kabsch); level where that is asked for or heights are missing."""
        ours, theirs = self._in_map[numbers], self._in_frame[numbers]
        known = self._known.reshape(-1, 3)[numbers, 2]
        middle, goal = ours.mean(axis=0), theirs.mean(axis=0)
        if self._is_level:
            across = (ours - middle)[:, :2].T @ (theirs - goal)[:, :2]
            turn = about_z(np.arctan2(across[0, 1] - across[1, 0], across[0, 0] + across[1, 1]))
            height = float(np.mean((theirs - ours)[known, 2])) if known.any() else 0.0
            shift = goal - turn @ middle
            return Pose(turn, np.array([shift[0], shift[1], height]))
        if not known.all():
            return None
        left, _, right = np.linalg.svd((theirs - goal).T @ (ours - middle))
        flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
        turn = left @ flip @ right
        return Pose(turn, goal - turn @ middle)

    def _contradiction(self, everyone: list[int]) -> str:
        fit = self.fit(everyone)
        assert fit is not None  # only a fit contradicts
        off = [self._residual(fit, i) for i in everyone]
        said = ", ".join(f"{one.name} by {100 * one.distance_m:.1f} cm" for one in off)
        return (
            f"the surveyed points contradict the map and no majority of them agrees ({said}); "
            "measure them again, or survey further points"
        )


def _starts(count: int, fewest: int) -> Iterator[tuple[int, ...]]:
    """Sets of so few points, evenly out of all there are."""
    every = math.ceil(math.comb(count, fewest) / _MOST_STARTS)
    return itertools.islice(itertools.combinations(range(count), fewest), 0, None, every)
