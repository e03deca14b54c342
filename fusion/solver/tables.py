"""A problem and its state as the tables that the core takes, and the state that it gives back."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from trigpoint.fusion.model.problem import Batch, CameraState, Chain, Layout, Problem, State
from trigpoint.geometry import Pose
from trigpoint.geometry.pose import rows_of
from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In, Out

_REAL, _WHOLE = np.float64, np.int64
_MOST_LENS = 12
# Of what a sigma of 0 holds.
_HELD_VARIANCE = 1e-18
_NOWHERE = Pose.identity()

STATE = (
    *(Out(_REAL, ("e", 12)), Out(_REAL, ("e", _MOST_LENS)), Out(_REAL, ("e", 2))),
    *(Out(_REAL, ("m", 12)), Out(_REAL, ("f", 12)), Out(_REAL, ("r", 2))),
)
PROBLEM = (
    *(In(_WHOLE, ("e", 4)), In(_WHOLE, ("r", 8))),
    *(In(_REAL, ("o", 12)), In(_REAL, ("r", 2))),
    *(In(_REAL, ("o", 6, 6)), In(_REAL, ("o", 6, 2))),
    *(In(_WHOLE, ("g", 5)), In(_REAL, ("g", 12)), In(_REAL, ("g", 2))),
    *(In(_REAL, ("g", 6)), In(_REAL, ("g", 6))),
    *(In(_WHOLE, ("k",)), In(_REAL, ("k", 3)), In(_REAL, ("k", 2)), In(_REAL, ("k",))),
    *(In(_WHOLE, ("v",)), In(_REAL, ("v", 2))),
    *(In(_REAL, ("f", 12)), In(_REAL, ("f", 6))),
    *(In(_WHOLE, ("z",)), In(_REAL, ("z", 12)), In(_REAL, ("y", "y"))),
    int,
)
"""As `Given` of problem.hpp says what each is."""


@dataclass(frozen=True, slots=True)
class StateTables:
    """The unknowns' values; the core writes the new ones into them."""

    cameras: Array
    lenses: Array
    clocks: Array
    nodes: Array
    faces: Array
    scales: Array

    @classmethod
    def of(cls, problem: Problem, state: State) -> Self:
        """Those of a problem's cameras and robots."""
        cameras = [state.cameras[name] for name in problem.layout.pose]
        robots = [state.robots[name] for name in problem.chains]
        lenses = np.zeros((len(cameras), _MOST_LENS))
        for row, camera in zip(lenses, cameras, strict=True):
            parameters = camera.lens.parameters
            row[: len(parameters)] = parameters
        return cls(
            rows_of(camera.map_from_camera for camera in cameras),
            lenses,
            _real([camera.clock for camera in cameras], 2),
            rows_of(robot.map_from_base for robot in robots),
            rows_of(robot.base_from_face for robot in robots),
            _real([robot.scales for robot in robots], 2),
        )

    def state(self, problem: Problem, before: State) -> State:
        """The state with these values; what the problem does not estimate is as `before`."""
        cameras, robots, layout = dict(before.cameras), dict(before.robots), problem.layout
        for row, name in enumerate(layout.pose):
            camera = cameras[name]
            lens, clock = camera.lens, self.clocks[row].tolist()
            if name in layout.lens:
                lens = lens.with_parameters(self.lenses[row, : len(layout.lens[name])])
            cameras[name] = CameraState(Pose.from_rows(self.cameras[row]), lens, *clock)
        node = face = 0
        for row, name in enumerate(problem.chains):
            robot = robots[name]
            nodes, faces = len(robot.map_from_base), len(robot.base_from_face)
            robots[name] = replace(
                robot,
                map_from_base=Pose.from_rows(self.nodes[node : node + nodes]),
                scales=self.scales[row].copy(),
                base_from_face=Pose.from_rows(self.faces[face : face + faces]),
            )
            node, face = node + nodes, face + faces
        return State(cameras, robots)

    def tables(self) -> tuple[Array, ...]:
        """In the order of `STATE`."""
        return self.cameras, self.lenses, self.clocks, self.nodes, self.faces, self.scales


def problem_tables(problem: Problem, state: State) -> tuple[np.ndarray | int, ...]:
    """In the order of `PROBLEM`."""
    layout, chains = problem.layout, problem.chains
    cameras = [
        (len(state.cameras[name].lens.parameters), *_columns(layout, name)) for name in layout.pose
    ]
    robots = [
        (
            *(len(chain), 0 if chain.motion is None else len(chain) - 1),
            *(len(state.robots[name].base_from_face), chain.planar, chain.is_anchored),
            *(_first(layout.scales, name), _first(layout.faces, name), _first(layout.last, name)),
        )
        for name, chain in chains.items()
    ]
    return (
        _whole(cameras, 4),
        _whole(robots, 8),
        *_motions(chains.values()),
        *_pictures(problem),
        *_priors(problem, state),
        layout.size,
    )


def _columns(layout: Layout, camera: str) -> tuple[int, int, int]:
    return (
        _first(layout.pose, camera),
        _first(layout.lens, camera),
        _first(layout.time_offset, camera),
    )


def _first(columns: dict[str, np.ndarray], name: str) -> int:
    return int(columns[name][0]) if name in columns else -1


def _motions(chains: Iterable[Chain]) -> tuple[Array, ...]:
    """The motions between nodes, the scales that they were computed at, their covariances, and
    their derivatives by the scales."""
    known = [chain.motion for chain in chains if chain.motion is not None]
    return (
        rows_of(motion.earlier_from_later for motion in known),
        _real([chain.scales for chain in chains], 2),
        _joined([motion.covariance for motion in known], 6, 6),
        _joined([motion.by_scale for motion in known], 6, 2),
    )


def _pictures(problem: Problem) -> tuple[np.ndarray, ...]:
    """All pictures, and their corners."""
    batches = problem.batches
    cameras = {name: row for row, name in enumerate(problem.layout.pose)}
    robots = {name: row for row, name in enumerate(problem.chains)}
    pictures = [_batch_rows(each, cameras[each.camera], robots[each.robot]) for each in batches]
    return (
        np.concatenate([np.empty((0, 5), _WHOLE), *pictures]),
        *map(np.concatenate, zip(_NO_WAYS, *map(_ways, batches), strict=True)),
        np.concatenate([np.empty(0, _WHOLE), *(each.faces.reshape(-1) for each in batches)]),
        _joined([each.face_points.reshape(-1, 3) for each in batches], 3),
        _joined([each.pixels.reshape(-1, 2) for each in batches], 2),
        _joined([each.weights.reshape(-1) for each in batches]),
    )


def _batch_rows(batch: Batch, camera: int, robot: int) -> np.ndarray:
    rows = np.empty((len(batch.nodes), 5), _WHOLE)
    rows[:] = camera, robot, 0, batch.weights.shape[1], batch.jitter is not None
    rows[:, 2] = batch.nodes
    return rows


_NO_WAYS = np.empty((0, 12)), np.empty((0, 2)), np.empty((0, 6)), np.empty((0, 6))


def _ways(batch: Batch) -> tuple[Array, Array, Array, Array]:
    """The ways from the nodes to the sightings, for which offset and when, the twists, and the
    variances of the deviations."""
    count, carried, still = len(batch.nodes), batch.carried, np.zeros((len(batch.nodes), 6))
    jitter = still if batch.jitter is None else batch.jitter
    if carried is None:
        way, twists, offset_s = _NOWHERE.repeated(count), still, np.zeros(count)
    else:
        way, twists, offset_s = carried.way, carried.twists, carried.offset_s
    return way.rows(), np.stack([offset_s, batch.since_epoch_s], axis=1), twists, jitter


def _priors(problem: Problem, state: State) -> tuple[np.ndarray, ...]:
    """Of lenses, clocks and scales, of all faces, and of known cameras."""
    priors, layout = problem.priors, problem.layout
    each = [(layout.lens[name], *prior) for name, prior in priors.lens.items()]
    each += [(layout.time_offset[n], np.zeros(2), s) for n, s in priors.time_offset.items()]
    each += [(layout.scales[name], np.zeros(2), s) for name, s in priors.scales.items()]
    faces = [_faces_prior(problem, state, name) for name in problem.chains]
    cameras = {name: row for row, name in enumerate(layout.pose)}
    return (
        np.concatenate([np.empty(0, _WHOLE), *(columns for columns, *_ in each)]),
        _real([pair for _, mean, s in each for pair in zip(mean, _variance(s), strict=True)], 2),
        rows_of(pose for pose, _ in faces),
        _joined([variance for _, variance in faces], 6),
        np.array([cameras[name] for name in priors.cameras], _WHOLE),
        rows_of(priors.cameras.values()),
        np.ascontiguousarray(priors.camera_information),
    )


def _faces_prior(problem: Problem, state: State, robot: str) -> tuple[Pose, Array]:
    """What a robot's faces (f) are expected to be, and the variances (f, 6)."""
    if robot not in problem.priors.faces:
        faces = state.robots[robot].base_from_face
        return faces, np.full((len(faces), 6), np.inf)
    faces, translation, rotation = problem.priors.faces[robot]
    return faces, np.tile(_variance(np.repeat([translation, rotation], 3)), (len(faces), 1))


def _variance(sigma: Array) -> Array:
    """Of independent sigmas; one of 0 holds its unknown fixed."""
    return np.where(sigma > 0, sigma**2, _HELD_VARIANCE)


def _joined(parts: list[Array], *shape: int) -> Array:
    return np.concatenate([np.empty((0, *shape)), *parts])


def _real(rows: Sequence[object], width: int) -> Array:
    return np.array(rows, _REAL).reshape(-1, width)


def _whole(rows: list[tuple[int, ...]], width: int) -> np.ndarray:
    return np.array(rows, _WHOLE).reshape(-1, width)
