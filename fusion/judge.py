"""Which corners and observations contradict the rest, at a solution."""

import numpy as np

from trigpoint.clock import to_ns
from trigpoint.geometry.rotation import Array

from .assembly import Assembled
from .dataset import DataSet
from .faces import best_reading
from .models import batch_jacobian
from .observations import Verdict
from .problem import Batch, Problem, State
from .solver import Solution

# χ² by which the next reading must be worse; e^(-25/2) is one in 300,000.
DECISIVE = 25.0
# A corner of a good sighting lies beyond this many sigmas once in 90 times, which costs little;
# those of pictures have tails (an edge half hidden, a marker near by), which bias a pose.
_WILD_SIGMAS = 3.0
# With more wild corners than this the whole observation is wrong.
_WILD_SHARE = 0.25
_BESIDE_NS = to_ns(2.0)
_MUCH_BETTER = 0.5


def judge(data: DataSet, assembled: Assembled, state: State) -> bool:
    """Mark outliers and rejected observations in the data set; whether anything changed."""
    changed, wrong = False, []
    for batch in assembled.problem.batches:
        length = _lengths(assembled.problem, batch, state)
        for row, source in enumerate(batch.sources):
            count = data.entries[source].observation.corner_count
            if _wild(length[row, :count]).mean() <= _WILD_SHARE:
                changed |= _mark_outliers(data, int(source), length[row, :count])
            elif _read_anew(data, int(source), state):
                changed = True
            else:
                wrong.append((int(source), float(np.nanmedian(length[row, :count]))))
    for source in _worst(data, wrong):
        entry = data.entries[source]
        entry.observation = entry.observation.judged(Verdict.REJECTED)
    return changed or bool(wrong)


def _worst(data: DataSet, wrong: list[tuple[int, float]]) -> list[int]:
    """Those that are not much better than another one of their robot at about their time: a wrong
    observation draws the good ones beside it off, which fit once it is gone."""
    found = []
    for source, length in wrong:
        mine = data.entries[source].observation
        beside = [
            other_length
            for other, other_length in wrong
            if data.entries[other].observation.robot == mine.robot
            and abs(data.entries[other].observation.stamp_ns - mine.stamp_ns) <= _BESIDE_NS
        ]
        if length >= _MUCH_BETTER * max(beside):
            found.append(source)
    return found


def _wild(length: Array) -> np.ndarray:
    return ~(length <= _WILD_SIGMAS)


def _lengths(problem: Problem, batch: Batch, state: State) -> Array:
    """Length of each corner's residual, sigmas, (n, K); NaN where its weight is 0."""
    _, residual, _ = batch_jacobian(problem, batch, state)
    with np.errstate(invalid="ignore", divide="ignore"):
        length = np.linalg.norm(residual, axis=-1) / (batch.weights > 0)
    return length / np.sqrt(batch.shares)[:, None]


def _mark_outliers(data: DataSet, source: int, length: Array) -> bool:
    """Mark the wild corners of an observation; whether these are others than before."""
    observation = data.entries[source].observation
    wild = _wild(length)
    if not wild.any():
        return False
    ends = np.cumsum([len(view.corners) for view in observation.views])[:-1]
    outliers = tuple(np.split(wild, ends))
    known = observation.outliers
    if known and all(np.array_equal(a, b) for a, b in zip(known, outliers, strict=True)):
        return False
    data.entries[source].observation = observation.with_outliers(outliers)
    return True


def _read_anew(data: DataSet, source: int, state: State) -> bool:
    """Read an observation as it fits where the robot is now; whether that is another reading."""
    entry = data.entries[source]
    observation = entry.observation
    if entry.map_from_base is None:
        return False
    camera = state.cameras[observation.camera]
    camera_from_base = camera.map_from_camera.inverse() @ entry.map_from_base
    target = data.targets[observation.robot]
    best = tuple(
        best_reading(view, target, camera.lens, camera_from_base)[0] for view in observation.views
    )
    if best == observation.chosen:
        return False
    entry.observation = observation.read_as(best)
    return True


def reprojection_rms_px(problem: Problem, state: State, camera: str) -> float | None:
    """RMS of a coordinate over a camera's used corners, pixels."""
    total, count = 0.0, 0
    for batch in problem.batches:
        if batch.camera == camera:
            _, residual, _ = batch_jacobian(problem, batch, state)
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
