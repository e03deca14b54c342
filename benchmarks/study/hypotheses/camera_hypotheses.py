"""A hypothesis of an unlocated camera's pose, refined: the camera, the robot's poses before it, and
odometry between them, as a small problem of its own."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from trigpoint.fusion.model.assembly import assemble
from trigpoint.fusion.model.dataset import DataSet, Entry
from trigpoint.fusion.model.gates import HUBER_SIGMAS
from trigpoint.fusion.model.observations import Reading, Verdict
from trigpoint.fusion.model.prediction import batch_residual
from trigpoint.fusion.model.problem import CameraState, Problem, State
from trigpoint.fusion.reading import faces
from trigpoint.fusion.reading.best_readings import read_where_they_are
from trigpoint.fusion.solver.levenberg_marquardt import solve
from trigpoint.geometry import Pose

_MOST_ROUNDS = 3


@dataclass(frozen=True, slots=True)
class Located:
    """A camera's pose, and how its observations are read and where the robot stood then."""

    camera: CameraState
    readings: dict[int, tuple[Reading, ...]]
    map_from_base: dict[int, Pose]

    @property
    def map_from_camera(self) -> Pose:
        return self.camera.map_from_camera


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """A possible pose of a camera; `cost`: χ² with the odometry's, `rms`: of a coordinate,
    sigmas."""

    located: Located
    cost: float
    rms: float

    def is_like(self, other: "Hypothesis") -> bool:
        """Whether it is the same solution."""
        return faces.is_same_pose(self.located.map_from_camera, other.located.map_from_camera)

    def lead(self, other: "Hypothesis") -> float:
        """χ² by which the other one is worse, in units of what this one leaves over."""
        return (other.cost - self.cost) / max(1.0, self.rms**2)


def distinct(found: Iterable[Hypothesis | None]) -> list[Hypothesis]:
    """The different ones, best first."""
    kept: list[Hypothesis] = []
    for hypothesis in sorted((h for h in found if h is not None), key=lambda h: h.cost):
        if not any(hypothesis.is_like(other) for other in kept):
            kept.append(hypothesis)
    return kept


def refine(
    data: DataSet, state: State, camera: str, start: Pose, indices: list[int]
) -> Hypothesis | None:
    """The best solution near a start, by these observations, whose robot pose must be known.

    Each is read as it fits best, again whenever the solution has moved; None where nothing fits.
    """
    trial = CameraState(start, data.lenses[camera])
    poses = {index: placed(data.entries[index]) for index in indices}
    before, hypothesis = None, None
    for _ in range(_MOST_ROUNDS):
        readings = _readings(data, trial, poses)
        if not readings or readings == before:
            break
        hypothesis = _solved(data, state, camera, trial, readings, poses)
        if hypothesis is None:
            break
        before, trial = readings, hypothesis.located.camera
        poses = poses | hypothesis.located.map_from_base
    return hypothesis


def placed(entry: Entry) -> Pose:
    """The robot's pose at an observation for which it is known."""
    assert entry.map_from_base is not None
    return entry.map_from_base


def _readings(
    data: DataSet, camera: CameraState, poses: dict[int, Pose]
) -> dict[int, tuple[Reading, ...]]:
    """The best reading of each observation; those that fit in no way are left out."""
    by_robot: dict[str, list[int]] = {}
    for index in poses:
        by_robot.setdefault(data.entries[index].observation.robot, []).append(index)
    found = {}
    from_map = camera.map_from_camera.inverse()
    for robot, indices in by_robot.items():
        seen = [data.entries[index].observation for index in indices]
        camera_from_base = from_map @ Pose.stack([poses[index] for index in indices])
        read = read_where_they_are(seen, data.targets[robot], camera.lens, camera_from_base)
        for index, (readings, rms) in zip(indices, read, strict=True):
            if np.all(np.isfinite(rms)):
                found[index] = readings
    return found


def _solved(
    data: DataSet,
    state: State,
    camera: str,
    trial: CameraState,
    readings: dict[int, tuple[Reading, ...]],
    poses: dict[int, Pose],
) -> Hypothesis | None:
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
    )
    solution = solve(assembled.problem, assembled.start, huber=HUBER_SIGMAS, tolerance=1e-3)
    if not np.isfinite(solution.cost):
        return None
    robots = solution.state.robots
    order = list(readings)
    where = {
        order[i]: robots[entries[i].observation.robot].map_from_base[node]
        for i, node in assembled.node_of.items()
    }
    # Observations that fit in no way cost as much as a picture full of outliers would.
    missing = HUBER_SIGMAS**2 * sum(
        data.entries[index].observation.corner_count for index in poses.keys() - where
    )
    located = Located(solution.state.cameras[camera], readings, where)
    rms = _median_rms(assembled.problem, solution.state)
    return Hypothesis(located, solution.cost + missing, rms)


def _median_rms(problem: Problem, state: State) -> float:
    """RMS of a coordinate over the corners but the wild ones, in sigmas: from the median of their
    lengths, which for normal coordinates is √(2 ln 2)."""
    lengths = []
    for batch in problem.batches:
        residual = batch_residual(batch, state)
        lengths.append(np.linalg.norm(residual, axis=-1)[batch.weights > 0])
    return float(np.median(np.concatenate(lengths)) / np.sqrt(2 * np.log(2)))
