"""Which corners, views and observations contradict the rest, at a solution."""

from dataclasses import dataclass

import numpy as np

from trigpoint.clock import to_ns
from trigpoint.fusion.model.assembly import Assembled
from trigpoint.fusion.model.dataset import DataSet, Entry
from trigpoint.fusion.model.gates import (
    WILD_CORNER_IN_TAILS_SIGMAS,
    WILD_CORNER_SIGMAS,
    WILD_SHARE,
)
from trigpoint.fusion.model.observations import Observation, Verdict, points_of, reprojection
from trigpoint.fusion.model.prediction import batch_residual
from trigpoint.fusion.model.problem import Batch, Problem, State
from trigpoint.fusion.reading.faces import best_reading
from trigpoint.fusion.solver.levenberg_marquardt import Solution
from trigpoint.fusion.solver.picture_jitter import PictureJitter
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

# Corners of pictures have tails: where more lie between these than noise puts there, the gate is
# the tighter one.
_TAIL_SIGMAS = (WILD_CORNER_IN_TAILS_SIGMAS, 5.0)
_SIGNIFICANT = 3.0
# A view that was left out whole and is still this far off, where the robot is thought to stand
# without it, would only draw the others away again.
_FAR_SIGMAS = 30.0
_BESIDE_NS = to_ns(2.0)
_MUCH_BETTER = 0.5
_LEAST_USED = 3


@dataclass(frozen=True, slots=True)
class _Wrong:
    """A view that contradicts the rest: which of which entry, and its corners' median length."""

    source: int
    order: int
    length: float


def judge(data: DataSet, assembled: Assembled, state: State) -> bool:
    """Mark wild corners and wrong views in the data set; whether anything changed.

    An observation all of whose views are wrong is rejected.
    """
    changed, wrong = False, []
    for batch in assembled.problem.batches:
        length = _lengths(assembled.problem, batch, state)
        limit = _limit(length)
        sound = np.sum(length <= limit, axis=1).tolist()
        for row, source in enumerate(batch.sources.tolist()):
            observation = data.entries[source].observation
            if not observation.outliers and sound[row] == observation.corner_count:
                continue
            views = observation.by_view(length[row])
            bad = [order for order, view in enumerate(views) if _is_wrong(view, limit)]
            if bad and _read_anew(data, source, state, bad):
                changed = True
                continue
            wild = tuple(
                ~(view <= limit) if order not in bad else _as_before(observation, order)
                for order, view in enumerate(views)
            )
            changed |= _mark(data, source, wild)
            wrong += [
                _Wrong(source, order, float(np.nanmedian(views[order])))
                for order in bad
                if np.any(np.isfinite(views[order]))
            ]
    for view in _worst(data, wrong):
        _leave_out(data, view)
    return changed or bool(wrong)


def reconsider(data: DataSet, state: State, source: int) -> None:
    """Take the corners and views of an observation back that were left out, but for a view that is
    far off where the robot stood by all the others."""
    entry = data.entries[source]
    observation, map_from_base = entry.observation, entry.map_from_base
    if not observation.outliers or observation.chosen is None:
        return
    fresh = observation.read_as(observation.chosen)
    if map_from_base is not None:
        far = [
            is_far and bool(np.all(before))
            for before, is_far in zip(
                observation.outliers, _are_far(data, state, fresh, map_from_base), strict=True
            )
        ]
        if any(far):
            fresh = _without(fresh, far)
    entry.observation = fresh


def without_far_views(data: DataSet, state: State, source: int) -> Observation | None:
    """A rejected observation without the views that are far off where the robot stood by all the
    others, which drew the good ones of the same picture off; None where all of them are far off, or
    none."""
    entry = data.entries[source]
    observation, map_from_base = entry.observation, entry.map_from_base
    if observation.chosen is None or map_from_base is None:
        return None
    far = _are_far(data, state, observation, map_from_base)
    return _without(observation, far) if any(far) and not all(far) else None


def _are_far(
    data: DataSet, state: State, observation: Observation, map_from_base: Pose
) -> list[bool]:
    """Which views of an observation are far off with the robot at a pose."""
    camera = state.cameras[observation.camera]
    points = points_of(observation, data.targets[observation.robot])
    pixels = reprojection(
        camera.lens,
        camera.map_from_camera,
        map_from_base,
        points.in_base(state.robots[observation.robot].base_from_face),
    )
    length = np.linalg.norm((pixels - points.pixels) * points.weights[:, None], axis=1)
    return [not np.nanmedian(view) <= _FAR_SIGMAS for view in observation.by_view(length)]


def _without(observation: Observation, left_out: list[bool]) -> Observation:
    """An observation without some of its views, one flag for each."""
    views = zip(observation.views, left_out, strict=True)
    return observation.with_outliers(tuple(np.full(len(v.corners), out) for v, out in views))


def _limit(length: Array) -> float:
    """Beyond how many sigmas a corner is wild."""
    good = length[np.isfinite(length)]
    low, high = _TAIL_SIGMAS
    # The length of a normal vector in the plane exceeds r with probability exp(-r²/2).
    expected = len(good) * (np.exp(-(low**2) / 2) - np.exp(-(high**2) / 2))
    tail = int(np.sum((good > low) & (good <= high)))
    has_tails = tail > expected + _SIGNIFICANT * np.sqrt(expected) + 1
    return WILD_CORNER_IN_TAILS_SIGMAS if has_tails else WILD_CORNER_SIGMAS


def _is_wrong(length: Array, limit: float) -> bool:
    return bool(np.mean(~(length <= limit)) > WILD_SHARE)


def _as_before(observation: Observation, order: int) -> np.ndarray:
    """The corners of a view that were wild before."""
    if observation.outliers:
        return observation.outliers[order]
    return np.zeros(len(observation.views[order].corners), dtype=bool)


def _mark(data: DataSet, source: int, wild: tuple[np.ndarray, ...]) -> bool:
    """Mark the wild corners of an observation; whether these are others than before."""
    entry = data.entries[source]
    before = [_as_before(entry.observation, order) for order in range(len(wild))]
    if all(np.array_equal(a, b) for a, b in zip(before, wild, strict=True)):
        return False
    entry.observation = entry.observation.with_outliers(wild)
    return True


def _worst(data: DataSet, wrong: list[_Wrong]) -> list[_Wrong]:
    """Those that are not much better than another one of their robot at about their time: a wrong
    view draws the good ones beside it off, which fit once it is gone."""
    found = []
    for view in wrong:
        mine = data.entries[view.source].observation
        beside = [
            other.length
            for other in wrong
            if data.entries[other.source].observation.robot == mine.robot
            and abs(data.entries[other.source].observation.stamp_ns - mine.stamp_ns) <= _BESIDE_NS
        ]
        if view.length >= _MUCH_BETTER * max(beside):
            found.append(view)
    return found


def _leave_out(data: DataSet, wrong: _Wrong) -> None:
    """Leave a whole view out, and reject an observation that has none left."""
    entry = data.entries[wrong.source]
    observation = entry.observation
    outliers = [_as_before(observation, order) for order in range(len(observation.views))]
    outliers[wrong.order] = np.ones_like(outliers[wrong.order])
    if all(np.all(wild) for wild in outliers):
        entry.observation = observation.with_outliers(()).judged(Verdict.REJECTED)
    else:
        entry.observation = observation.with_outliers(tuple(outliers))


def _lengths(problem: Problem, batch: Batch, state: State) -> Array:
    """Length of each corner's residual, sigmas, (n, K); NaN where its weight is 0."""
    residual = batch_residual(problem, batch, state)
    jitter = PictureJitter.of(problem, batch, state)
    if jitter is not None:
        flat = residual.reshape(len(residual), -1)
        residual = jitter.compensated(flat).reshape(residual.shape)
    with np.errstate(invalid="ignore", divide="ignore"):
        length = np.linalg.norm(residual, axis=-1) / (batch.weights > 0)
    return length / np.sqrt(batch.shares)[:, None]


def _read_anew(data: DataSet, source: int, state: State, bad: list[int]) -> bool:
    """Read the bad views of an observation as they fit where the robot is now; whether that is
    another reading."""
    entry = data.entries[source]
    observation = entry.observation
    if entry.map_from_base is None or observation.chosen is None:
        return False
    camera = state.cameras[observation.camera]
    camera_from_base = camera.map_from_camera.inverse() @ entry.map_from_base
    target = data.targets[observation.robot]
    chosen = list(observation.chosen)
    for order in bad:
        view = observation.views[order]
        chosen[order] = best_reading(view, target, camera.lens, camera_from_base)[0]
    if tuple(chosen) == observation.chosen:
        return False
    entry.observation = observation.read_as(tuple(chosen))
    return True


def reprojection_rms_px(problem: Problem, state: State, camera: str) -> float | None:
    """RMS of a coordinate over a camera's used corners, pixels."""
    total, count = 0.0, 0
    for batch in problem.batches:
        if batch.camera == camera:
            residual = batch_residual(problem, batch, state)
            used = batch.weights > 0
            total += float(np.sum((residual[used] / batch.weights[used][:, None]) ** 2))
            count += 2 * int(used.sum())
    return float(np.sqrt(total / count)) if count else None


def chi2_per_dof(problem: Problem, solution: Solution) -> float | None:
    """Cost over its degrees of freedom: 1 where noise is what it was said to be."""
    corners = sum(
        float(((batch.weights > 0) * batch.shares[:, None]).sum()) for batch in problem.batches
    )
    odometry = sum(
        len(chain.tangent) * (len(chain) - 1)
        for chain in problem.chains.values()
        if chain.motion is not None
    )
    nodes = sum(
        len(chain.tangent) * (len(chain) - int(chain.is_anchored))
        for chain in problem.chains.values()
    )
    last = sum(column.stop - column.start for column in problem.layout.last.values())
    priors = problem.layout.size - last - 6 * len(problem.layout.pose)
    priors += 6 * len(problem.priors.cameras)
    unknowns = nodes + problem.layout.size - last
    freedom = 2 * corners + odometry + priors - unknowns
    return solution.cost / freedom if freedom > 0 else None


def may_have_moved(entries: list[Entry]) -> bool:
    """Whether a camera's observations were used up to a moment, and contradict since then."""
    used = [e.observation.stamp_ns for e in entries if e.observation.verdict is Verdict.ACCEPTED]
    wrong = [e.observation.stamp_ns for e in entries if e.observation.verdict is Verdict.REJECTED]
    if len(used) < _LEAST_USED or not wrong:
        return False
    return min(wrong) > max(used)
