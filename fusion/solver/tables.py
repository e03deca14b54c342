"""A problem and its state as the tables that the core takes; `Given` in problem.hpp says what each
of them is."""

from collections.abc import Iterable

import numpy as np
from msgspec.structs import replace

from trigpoint.fusion.model.problem import Batch, CameraState, Chain, Problem, State
from trigpoint.geometry import Pose
from trigpoint.geometry.pose import rows_of
from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In, Out

_REAL, _WHOLE = np.float64, np.int64
_MOST_LENS = 12
# Of what a sigma of 0 holds.
_HELD_VARIANCE = 1e-18

STATE = (
    *(Out(_REAL, ("e", 12)), Out(_REAL, ("e", _MOST_LENS)), Out(_REAL, ("e", 2))),
    *(Out(_REAL, ("m", 12)), Out(_REAL, ("f", 12)), Out(_REAL, ("r", 2))),
)
PROBLEM = (
    *(In(_WHOLE, ("e", 4)), In(_WHOLE, ("r", 8))),
    *(In(_REAL, ("o", 12)), In(_REAL, ("r", 2))),
    *(In(_REAL, ("o", 6, 6)), In(_REAL, ("o", 6, 2))),
    *(In(_WHOLE, ("g", 5)), In(_REAL, ("g", 12)), In(_REAL, ("g", 2))),
    *(In(_REAL, ("g", 6)), In(_REAL, ("g", 12))),
    *(In(_WHOLE, ("k",)), In(_REAL, ("k", 3)), In(_REAL, ("k", 2)), In(_REAL, ("k",))),
    *(In(_WHOLE, ("v",)), In(_REAL, ("v", 2))),
    *(In(_REAL, ("f", 12)), In(_REAL, ("f", 6))),
    *(In(_WHOLE, ("z",)), In(_REAL, ("z", 12))),
    *(In(_WHOLE, ("w",)), In(_REAL, ("w",)), In(_REAL, ("y", "y"))),
    int,
)


def state_tables(problem: Problem, state: State) -> tuple[Array, ...]:
    """The values of a problem's unknowns, into which the core writes the new ones: `STATE`."""
    cameras = [state.cameras[name] for name in problem.layout.pose]
    robots = [state.robots[name] for name in problem.chains]
    lenses = np.zeros((len(cameras), _MOST_LENS))
    for row, camera in zip(lenses, cameras, strict=True):
        parameters = camera.lens.parameters
        row[: len(parameters)] = parameters
    return (
        rows_of(camera.map_from_camera for camera in cameras),
        lenses,
        np.array([camera.clock for camera in cameras], _REAL).reshape(-1, 2),
        rows_of(robot.map_from_base for robot in robots),
        rows_of(robot.base_from_face for robot in robots),
        np.array([robot.scales for robot in robots], _REAL).reshape(-1, 2),
    )


def state_of(problem: Problem, before: State, tables: tuple[Array, ...]) -> State:
    """The state with the values of `state_tables`; all that they leave out is as `before`."""
    eyes, lenses, clocks, nodes, faces, scales = tables
    cameras, robots = dict(before.cameras), dict(before.robots)
    for row, name in enumerate(problem.layout.pose):
        lens = cameras[name].lens
        if name in problem.layout.lens:
            lens = lens.with_parameters(lenses[row, : len(lens.parameters)])
        cameras[name] = CameraState(Pose.from_rows(eyes[row]), lens, *clocks[row].tolist())
    node = face = 0
    for row, name in enumerate(problem.chains):
        first, node = node, node + len(robots[name].map_from_base)
        begin, face = face, face + len(robots[name].base_from_face)
        robots[name] = replace(
            robots[name],
            map_from_base=Pose.from_rows(nodes[first:node]),
            scales=scales[row].copy(),
            base_from_face=Pose.from_rows(faces[begin:face]),
        )
    return State(cameras, robots)


def problem_tables(problem: Problem, state: State) -> tuple[np.ndarray | int, ...]:
    """What stays while a problem is solved: `PROBLEM`."""
    layout, robots = problem.layout, [state.robots[name] for name in problem.chains]
    cameras = [
        (
            len(state.cameras[name].lens.parameters),
            *(_first(columns, name) for columns in (layout.pose, layout.lens, layout.time_offset)),
        )
        for name in layout.pose
    ]
    chains = [
        (
            *(len(chain), 0 if chain.motion is None else len(chain) - 1),
            *(len(robot.base_from_face), chain.planar, chain.is_anchored),
            *(_first(columns, name) for columns in (layout.scales, layout.faces, layout.last)),
        )
        for (name, chain), robot in zip(problem.chains.items(), robots, strict=True)
    ]
    return (
        np.array(cameras, _WHOLE).reshape(-1, 4),
        np.array(chains, _WHOLE).reshape(-1, 8),
        *_motions(problem.chains.values()),
        *_pictures(problem),
        *_priors(problem, state),
        layout.size,
    )


def _first(columns: dict[str, np.ndarray], name: str) -> int:
    return int(columns[name][0]) if name in columns else -1


def _motions(chains: Iterable[Chain]) -> tuple[Array, ...]:
    known = [chain.motion for chain in chains if chain.motion is not None]
    return (
        rows_of(motion.earlier_from_later for motion in known),
        np.array([chain.scales for chain in chains], _REAL).reshape(-1, 2),
        _joined([motion.covariance for motion in known], 6, 6),
        _joined([motion.by_scale for motion in known], 6, 2),
    )


def _pictures(problem: Problem) -> tuple[np.ndarray, ...]:
    cameras = {name: row for row, name in enumerate(problem.layout.pose)}
    robots = {name: row for row, name in enumerate(problem.chains)}
    rows = [np.empty((0, 5), _WHOLE)]
    for batch in problem.batches:
        rows.append(np.empty((len(batch.nodes), 5), _WHOLE))
        corners, has_jitter = batch.weights.shape[1], batch.jitter is not None
        rows[-1][:] = cameras[batch.camera], robots[batch.robot], 0, corners, has_jitter
        rows[-1][:, 2] = batch.nodes
    return (
        np.concatenate(rows),
        *map(np.concatenate, zip(_NO_WAYS, *map(_ways, problem.batches), strict=True)),
        np.concatenate([np.empty(0, _WHOLE), *(b.faces.reshape(-1) for b in problem.batches)]),
        _joined([batch.face_points.reshape(-1, 3) for batch in problem.batches], 3),
        _joined([batch.pixels.reshape(-1, 2) for batch in problem.batches], 2),
        _joined([batch.weights.reshape(-1) for batch in problem.batches]),
    )


_NO_WAYS = np.empty((0, 12)), np.empty((0, 2)), np.empty((0, 6)), np.empty((0, 12))


def _ways(batch: Batch) -> tuple[Array, Array, Array, Array]:
    """From the nodes to the sightings, for which offset and when, twists, variances of jitter."""
    count, carried, none = len(batch.nodes), batch.carried, np.zeros((len(batch.nodes), 6))
    way, twists, offset_s = Pose.identity().repeated(count), none, none[:, 0]
    if carried is not None:
        way, twists, offset_s = carried.way, carried.twists, carried.offset_s
    moments = np.stack([offset_s, batch.since_epoch_s], axis=1)
    jitter = np.zeros((count, 2, 6)) if batch.jitter is None else batch.jitter
    return way.rows(), moments, twists, jitter.reshape(count, 12)


def _priors(problem: Problem, state: State) -> tuple[np.ndarray, ...]:
    """Of lenses, clocks and scales, of all faces, and of what is known from before."""
    priors, layout = problem.priors, problem.layout
    each = [(layout.lens[name], *prior) for name, prior in priors.lens.items()]
    each += [(layout.time_offset[n], np.zeros(2), s) for n, s in priors.time_offset.items()]
    each += [(layout.scales[name], np.zeros(2), s) for name, s in priors.scales.items()]
    numbers = [np.stack([expected, _variance(sigma)], axis=1) for _, expected, sigma in each]
    faces = [_faces_prior(problem, state, name) for name in problem.chains]
    return (
        np.concatenate([np.empty(0, _WHOLE), *(columns for columns, *_ in each)]),
        _joined(numbers, 2),
        rows_of(expected for expected, _ in faces),
        _joined([variance for _, variance in faces], 6),
        *_known(problem, state),
    )


def _known(problem: Problem, state: State) -> tuple[np.ndarray, ...]:
    """What is known from before: which poses, and what is expected of them; of which columns, and
    what of these; and the information."""
    known, layout = problem.priors.known, problem.layout
    cameras = {name: row for row, name in enumerate(layout.pose)}
    faces, first = {}, len(cameras)
    for name in problem.chains:
        count = len(state.robots[name].base_from_face)
        faces[name], first = range(first, first + count), first + count
    rows = [cameras[name] for name in known.poses]
    rows += [row for name in known.faces for row in faces[name]]
    columns = {"lens": layout.lens, "clock": layout.time_offset, "scales": layout.scales}
    mine = [columns[kind][owner] for kind, owner in known.values]
    return (
        np.array(rows, _WHOLE),
        rows_of([*known.poses.values(), *known.faces.values()]),
        np.concatenate([np.empty(0, _WHOLE), *mine]),
        _joined(list(known.values.values())),
        np.ascontiguousarray(known.information),
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
