"""Finds an unlocated camera's pose from its observations, without a guess.

Candidates come from single observations; each is held against all of them, the best few are refined
as a small problem of their own (this camera, the robot's poses before it, odometry between them),
and the best is taken only where it fits and no other comes near.
"""

from dataclasses import dataclass, replace

import numpy as np

from trigpoint.geometry import Pose

from . import faces, looks
from .assembly import assemble
from .dataset import DataSet, Entry
from .models import batch_jacobian
from .observations import Reading, Verdict
from .problem import CameraState, Problem, State
from .solver import solve

MOST_SEEDS = 10
MOST_LOOKS = 24
MOST_REFINED = 4
# χ² by which the runner-up must be worse; e^(-25/2) is one in 300,000.
DECISIVE = 25.0
_ACCEPTABLE_RMS = 3.0
_HUBER = 4.0


@dataclass(frozen=True, slots=True)
class Located:
    """A camera's pose, and how its observations are read and where the robot stood then."""

    camera: CameraState
    readings: dict[int, tuple[Reading, ...]]
    map_from_base: dict[int, Pose]


@dataclass(frozen=True, slots=True)
class Undetermined:
    """Why a camera could not be located, in words."""

    reasons: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Hypothesis:
    located: Located
    cost: float
    rms: float


def locate(data: DataSet, state: State, camera: str) -> Located | Undetermined:
    """Locate a camera by the observations of it whose robot pose is known."""
    indices = [
        index
        for index, entry in enumerate(data.entries)
        if entry.observation.camera == camera and entry.map_from_base is not None
    ]
    if not indices:
        return Undetermined(("the robot that it saw is not tied to the map yet",))
    few = _spread(indices, MOST_LOOKS)
    starts = _best_starts(data, camera, few)
    if not starts:
        return Undetermined(("no picture of it shows enough of a face to place it",))
    hypotheses: list[_Hypothesis] = []
    for start in starts:
        hypothesis = _refine(data, state, camera, start, few)
        if hypothesis is not None and not _is_known(hypothesis, hypotheses):
            hypotheses.append(hypothesis)
    if not hypotheses:
        return Undetermined(("its pictures contradict each other and the odometry",))
    return _decide(data, state, camera, indices, hypotheses)


def _decide(
    data: DataSet, state: State, camera: str, indices: list[int], hypotheses: list[_Hypothesis]
) -> Located | Undetermined:
    hypotheses.sort(key=lambda hypothesis: hypothesis.cost)
    best = hypotheses[0]
    if best.rms > _ACCEPTABLE_RMS:
        return Undetermined(
            (f"no pose fits its pictures (the best is off by {best.rms:.1f} sigmas)",)
        )
    if len(hypotheses) > 1:
        margin = (hypotheses[1].cost - best.cost) / max(1.0, best.rms**2)
        if margin < DECISIVE:
            return Undetermined((_two_poses(best, hypotheses[1]),))
    final = _refine(data, state, camera, best.located.camera.map_from_camera, indices)
    return final.located if final is not None else best.located


def _two_poses(first: _Hypothesis, second: _Hypothesis) -> str:
    places = [
        "({:.2f}, {:.2f}, {:.2f})".format(*h.located.camera.map_from_camera.translation)
        for h in (first, second)
    ]
    return f"position and orientation: a camera at {places[0]} m and one at {places[1]} m fit alike"


def _spread(indices: list[int], most: int) -> list[int]:
    """At most `most` of them, evenly spread."""
    if len(indices) <= most:
        return indices
    return [indices[i] for i in np.linspace(0, len(indices) - 1, most).round().astype(int)]


def _best_starts(data: DataSet, camera: str, indices: list[int]) -> list[Pose]:
    """The few distinct camera poses that fit these observations best."""
    lens = data.lenses[camera]
    poses = []
    for index in _spread(indices, MOST_SEEDS):
        entry = data.entries[index]
        target = data.targets[entry.observation.robot]
        poses += [
            _placed(entry) @ candidate.camera_from_base.inverse()
            for candidate in faces.candidates(entry.observation, target, lens)
        ]
    if not poses:
        return []
    seen = [
        looks.look_of(
            data.entries[i].observation,
            data.targets[data.entries[i].observation.robot],
            _placed(data.entries[i]),
        )
        for i in indices
    ]
    costs = looks.mean_cost(Pose.stack(poses), seen, lens)
    chosen: list[Pose] = []
    for index in np.argsort(costs, kind="stable"):
        if not any(faces.is_same_pose(poses[index], other) for other in chosen):
            chosen.append(poses[index])
        if len(chosen) == MOST_REFINED:
            break
    return chosen


def _placed(entry: Entry) -> Pose:
    assert entry.map_from_base is not None  # `locate` chose the entries by it
    return entry.map_from_base


def _refine(
    data: DataSet, state: State, camera: str, start: Pose, indices: list[int]
) -> _Hypothesis | None:
    """The small problem of one camera from one start; readings are looked at twice."""
    trial = CameraState(start, data.lenses[camera])
    poses = {index: _placed(data.entries[index]) for index in indices}
    hypothesis = None
    for _ in range(2):
        readings = _readings(data, trial, poses)
        if not readings:
            return None
        hypothesis = _solved(data, state, camera, trial, readings, poses)
        if hypothesis is None:
            return None
        trial = hypothesis.located.camera
        poses = poses | hypothesis.located.map_from_base
    return hypothesis


def _readings(
    data: DataSet, camera: CameraState, poses: dict[int, Pose]
) -> dict[int, tuple[Reading, ...]]:
    """How each observation is read best, left out where it fits in no way."""
    found = {}
    from_map = camera.map_from_camera.inverse()
    for index, map_from_base in poses.items():
        observation = data.entries[index].observation
        target = data.targets[observation.robot]
        best = [
            faces.best_reading(view, target, camera.lens, from_map @ map_from_base)
            for view in observation.views
        ]
        if all(np.isfinite(rms) for _, rms, _ in best):
            found[index] = tuple(reading for reading, _, _ in best)
    return found


def _solved(
    data: DataSet,
    state: State,
    camera: str,
    trial: CameraState,
    readings: dict[int, tuple[Reading, ...]],
    poses: dict[int, Pose],
) -> _Hypothesis | None:
    entries = [
        Entry(
            data.entries[index].observation.read_as(chosen).judged(Verdict.ACCEPTED), poses[index]
        )
        for index, chosen in readings.items()
    ]
    small = replace(data, entries=entries)
    assembled = assemble(
        small,
        State({camera: trial}, state.robots),
        list(range(len(entries))),
        anchored=False,
        fill=False,
    )
    solution = solve(assembled.problem, assembled.start, huber=_HUBER, tolerance=1e-3)
    if not np.isfinite(solution.cost):
        return None
    robots = solution.state.robots
    order = list(readings)
    where = {
        order[i]: robots[entries[i].observation.robot].map_from_base[node]
        for i, node in assembled.node_of.items()
    }
    # Observations that fit in no way cost as much as a picture full of outliers would.
    missing = sum(
        _HUBER**2 * data.entries[index].observation.corner_count for index in poses.keys() - where
    )
    located = Located(solution.state.cameras[camera], readings, where)
    rms = _median_rms(assembled.problem, solution.state)
    return _Hypothesis(located, solution.cost + missing, rms)


def _median_rms(problem: Problem, state: State) -> float:
    """RMS of a coordinate over the corners but the wild ones, in sigmas: from the median of their
    lengths, which for normal coordinates is √(2 ln 2)."""
    lengths = []
    for batch in problem.batches:
        _, residual, _ = batch_jacobian(problem, batch, state)
        lengths.append(np.linalg.norm(residual, axis=-1)[batch.weights > 0])
    return float(np.median(np.concatenate(lengths)) / np.sqrt(2 * np.log(2)))


def _is_known(hypothesis: _Hypothesis, others: list[_Hypothesis]) -> bool:
    pose = hypothesis.located.camera.map_from_camera
    return any(faces.is_same_pose(pose, other.located.camera.map_from_camera) for other in others)
