"""The least-squares problem written out in numpy: every residual in one column, every unknown in
one row, nothing eliminated. The core is held to it."""

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from support.fusion.picture_jitter import PictureJitter

from trigpoint.fusion.model.motion import Motion
from trigpoint.fusion.model.prediction import (
    batch_jacobian,
    batch_residual,
    odometry_terms,
)
from trigpoint.fusion.model.problem import Batch, CameraState, Layout, Problem, RobotState, State
from trigpoint.fusion.solver.equations import EXACT
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.rotation import Array


class Slow(Struct):
    """Half the Hessian (u, u) and the gradient (u,) of the cost: each chain's inner nodes, then the
    dense part."""

    matrix: Array
    gradient: Array
    cost: float = 0.0
    log_determinant: float = 0.0

    def add(self, columns: np.ndarray, jacobian: Array, residual: Array) -> None:
        """A term with the derivatives (m, q) of residuals (m,) by the unknowns in columns (q,)."""
        self.matrix[np.ix_(columns, columns)] += jacobian.T @ jacobian
        self.gradient[columns] += jacobian.T @ residual
        self.cost += float(residual @ residual)


def dense_row(problem: Problem) -> int:
    """Where the dense part begins."""
    return sum((len(chain) - 1) * len(chain.tangent) for chain in problem.chains.values())


def node_rows(problem: Problem, robot: str, node: int) -> np.ndarray:
    """The unknowns (d,) of a robot's node."""
    start = 0
    for name, chain in problem.chains.items():
        d = len(chain.tangent)
        if name == robot:
            if node == len(chain) - 1:
                return dense_row(problem) + problem.layout.last[robot]
            return start + node * d + np.arange(d)
        start += (len(chain) - 1) * d
    raise KeyError(robot)


def slow_equations(problem: Problem, state: State, *, huber: float = np.inf) -> Slow:
    """The normal equations at a state; corners beyond `huber` sigmas have a linear cost."""
    first = dense_row(problem)
    size = first + problem.layout.size
    slow = Slow(np.zeros((size, size)), np.zeros(size))
    for batch in problem.batches:
        for picture in range(len(batch.nodes)):
            _add_picture(slow, problem, picture_of(batch, picture), state, huber)
    for name, chain in problem.chains.items():
        _add_odometry(slow, problem, name, state.robots[name])
        if chain.is_anchored:
            held = node_rows(problem, name, 0)
            slow.matrix[held, held] += EXACT
    for columns, error, root in _priors(problem, state):
        slow.add(first + columns, root, root @ error)
    if problem.priors.known.poses:
        _add_known(slow, problem, state)
    return slow


def picture_of(batch: Batch, picture: int) -> Batch:
    """A batch of one of its pictures."""
    row = slice(picture, picture + 1)
    carried = batch.carried
    if carried is not None:
        carried = replace(
            carried,
            way=carried.way[row],
            twists=carried.twists[row],
            offset_s=carried.offset_s[row],
        )
    parts = "nodes", "face_points", "faces", "pixels", "weights", "shares", "sources"
    rows = {name: getattr(batch, name)[row] for name in (*parts, "since_epoch_s")}
    jitter = None if batch.jitter is None else batch.jitter[row]
    return replace(batch, **rows, carried=carried, jitter=jitter)


def _add_picture(slow: Slow, problem: Problem, batch: Batch, state: State, huber: float) -> None:
    jacobian, residual, columns = batch_jacobian(problem, batch, state)
    jacobian, left = jacobian[0], residual[0]
    jitter = PictureJitter.of(batch, state)
    if jitter is not None:
        residual = about_best_fit(batch, state, jitter)
        left = jitter.compensated(residual.reshape(1, -1)).reshape(-1, 2)
    length = np.linalg.norm(left, axis=-1)
    weight = np.minimum(1.0, huber / np.maximum(length, 1e-12))
    root = np.sqrt(weight)[:, None]
    rows = (root[..., None] * jacobian).reshape(-1, jacobian.shape[-1])
    residual = (root * residual.reshape(-1, 2)).reshape(-1)
    is_far = weight < 1
    # Beside the weighted square, which of what is far is huber · length.
    slow.cost += huber * float(np.sum(length[is_far] - huber)) if np.any(is_far) else 0.0
    if jitter is not None:
        far = jitter.jacobian[0] * np.repeat(root, 2, axis=0)
        jitter = PictureJitter.by(far[None], jitter.variances)
        rows, residual = (part[0] for part in jitter.rows(rows[None], residual[None]))
        whole = jitter.variances[..., None] * jitter.information
        slow.log_determinant += float(np.sum(np.linalg.slogdet(whole)[1]))
    nodes = node_rows(problem, batch.robot, int(batch.nodes[0]))
    slow.add(np.concatenate([nodes, dense_row(problem) + columns]), rows, residual)


def about_best_fit(batch: Batch, state: State, jitter: PictureJitter) -> Array:
    """The residual (2K,) of one picture, linearised about the deviation that fits best by its own
    variances."""
    assert batch.jitter is not None
    by_seen, residual = jitter.jacobian[0], batch_residual(batch, state).reshape(-1)
    alone = PictureJitter.by(jitter.jacobian, batch.jitter[:, 1])
    fit = -np.linalg.solve(alone.information[0], by_seen.T @ residual)
    robot, camera = state.robots[batch.robot], state.cameras[batch.camera]
    seen = robot.map_from_base[batch.nodes]
    if batch.carried is not None:
        seen = seen @ batch.carried.at(camera.offset_s(batch.since_epoch_s))
    there = replace(robot, map_from_base=seen.disturbed(fit))
    state = State(state.cameras, state.robots | {batch.robot: there})
    about = replace(batch, nodes=np.zeros(1, dtype=int), carried=None)
    return batch_residual(about, state).reshape(-1) - by_seen @ fit


def _add_odometry(slow: Slow, problem: Problem, name: str, robot: RobotState) -> None:
    chain, nodes = problem.chains[name], robot.map_from_base
    if chain.motion is None:
        return
    motion = rescaled(chain.motion, robot.scales - chain.scales)
    terms = odometry_terms(nodes[:-1], nodes[1:], motion, chain.tangent)
    scales = problem.layout.scales_of(name)
    for step in range(len(chain) - 1):
        columns = np.concatenate(
            [
                node_rows(problem, name, step),
                node_rows(problem, name, step + 1),
                dense_row(problem) + scales,
            ]
        )
        parts = terms.by_earlier[step], terms.by_later[step], terms.by_scale[step, :, : len(scales)]
        slow.add(columns, np.concatenate(parts, axis=1), terms.residual[step])


def rescaled(motion: Motion, change: Array) -> Motion:
    """The motion after a small change (2,) of the scale errors, to first order."""
    moved = motion.earlier_from_later.disturbed(motion.by_scale @ change)
    return replace(motion, earlier_from_later=moved)


def _priors(problem: Problem, state: State) -> list[tuple[np.ndarray, Array, Array]]:
    """Columns, errors and the root of the information of all priors with independent sigmas."""
    priors, layout, found = problem.priors, problem.layout, []

    def put(columns: np.ndarray, error: Array, sigma: Array) -> None:
        variance = np.where(sigma > 0, sigma**2, 1e-18)
        found.append((columns, error, np.diag(np.sqrt(1 / variance))))

    for name, (expected, sigma) in priors.lens.items():
        put(layout.lens[name], state.cameras[name].lens.parameters - expected, sigma)
    for name, sigma in priors.time_offset.items():
        camera = state.cameras[name]
        error = np.array([camera.time_offset_s, camera.time_drift])
        put(layout.time_offset[name], error, sigma)
    for name, sigma in priors.scales.items():
        put(layout.scales[name], state.robots[name].scales, sigma)
    for name, (expected, translation, rotation) in priors.faces.items():
        error = state.robots[name].base_from_face.difference(expected).reshape(-1)
        sigma = np.tile(np.repeat([translation, rotation], 3), len(expected))
        put(layout.faces[name], error, sigma)
    return found


def _add_known(slow: Slow, problem: Problem, state: State) -> None:
    columns, errors, poses = known_errors(problem, state)
    jacobian = np.eye(len(columns))
    for index in range(poses):
        rows = slice(6 * index + 3, 6 * index + 6)
        jacobian[rows, rows] = np.linalg.inv(so3.left_jacobian(errors[rows]))
    root = np.linalg.cholesky(problem.priors.known.information)
    slow.add(dense_row(problem) + columns, root.T @ jacobian, root.T @ errors)


def known_errors(problem: Problem, state: State) -> tuple[np.ndarray, Array, int]:
    """Of what is known from before: the dense columns (n,), the errors (n,), and how many poses
    these begin with."""
    known, layout = problem.priors.known, problem.layout
    errors = [state.cameras[n].map_from_camera.difference(p) for n, p in known.poses.items()]
    columns = [layout.pose[name] for name in known.poses]
    for name, faces in known.faces.items():
        errors += list(state.robots[name].base_from_face.difference(faces))
        columns.append(layout.faces[name])
    poses = len(errors)
    for (kind, name), expected in known.values.items():
        if kind == "scales":
            columns.append(layout.scales[name])
            errors.append(state.robots[name].scales - expected)
        else:
            camera = state.cameras[name]
            columns.append((layout.lens if kind == "lens" else layout.time_offset)[name])
            value = camera.lens.parameters if kind == "lens" else np.array(camera.clock)
            errors.append(value - expected)
    return np.concatenate(columns), np.concatenate(errors), poses


def slow_minimum(
    problem: Problem, state: State, *, huber: float, tolerance: float, most_iterations: int
) -> tuple[State, Slow, int, bool]:
    """The damped iteration: the state, the equations there, the iterations, whether it has
    converged."""
    damping, equations = 0.0, slow_equations(problem, state, huber=huber)
    first, iterations = dense_row(problem), 0
    while iterations < most_iterations and damping < 1e8:
        iterations += 1
        try:
            step = _damped_step(equations, damping, first)
        except LinAlgError:
            damping = max(damping * 100, 1e-6)
            continue
        promised = -float(equations.gradient @ step)
        if promised < tolerance:
            return state, equations, iterations, True
        nodes = {
            name: step[np.concatenate(rows)].reshape(len(rows), -1)
            for name, chain in problem.chains.items()
            if (rows := [node_rows(problem, name, node) for node in range(len(chain) - 1)])
        }
        moved = moved_state(problem, state, step[first:], nodes)
        candidate = slow_equations(problem, moved, huber=huber)
        if np.isfinite(candidate.cost) and candidate.cost <= equations.cost:
            state, equations = moved, candidate
            damping = damping / 30 if damping > 1e-9 else 0.0
        elif (
            damping <= 1e-6
            and np.isfinite(candidate.cost)
            and promised < min(100 * tolerance, 0.01)
        ):
            return state, equations, iterations, True
        else:
            damping = max(damping * 30, 1e-6)
    return state, equations, iterations, False


def _damped_step(equations: Slow, damping: float, first: int) -> Array:
    """The chains are damped by their own information, the dense part by what is left of its."""
    matrix = equations.matrix.copy()
    inner = np.arange(first)
    matrix[inner, inner] *= 1 + damping
    a, b, c = matrix[:first, :first], matrix[:first, first:], matrix[first:, first:]
    reduced = c - b.T @ np.linalg.solve(a, b)
    outer = np.arange(first, len(matrix))
    matrix[outer, outer] += damping * np.abs(np.diagonal(reduced))
    diagonal = np.diagonal(matrix)
    if np.any(diagonal <= 0):
        raise LinAlgError("singular")
    scale = 1 / np.sqrt(diagonal)
    factor = cho_factor(matrix * scale[:, None] * scale, lower=True)
    return -scale * cho_solve(factor, scale * equations.gradient)


def moved_state(
    problem: Problem, state: State, step: Array, chain_steps: dict[str, Array]
) -> State:
    """The state after a step of the dense part and of the chains' inner nodes (n, d)."""
    layout = problem.layout
    cameras = dict(state.cameras)
    for name in layout.pose:
        cameras[name] = _moved_camera(state.cameras[name], layout, name, step)
    robots = dict(state.robots)
    for name in problem.chains:
        robots[name] = _moved_robot(problem, state.robots[name], name, step, chain_steps.get(name))
    return State(cameras, robots)


def _moved_camera(camera: CameraState, layout: Layout, name: str, step: Array) -> CameraState:
    pose = camera.map_from_camera.moved(step[layout.pose[name]])
    lens, offset, drift = camera.lens, camera.time_offset_s, camera.time_drift
    if name in layout.lens:
        parameters = lens.parameters + step[layout.lens[name]]
        parameters[:2] = np.maximum(parameters[:2], 1.0)  # a focal length stays positive
        lens = lens.with_parameters(parameters)
    if name in layout.time_offset:
        change = step[layout.time_offset[name]]
        offset, drift = offset + float(change[0]), drift + float(change[1])
    return CameraState(pose, lens, offset, drift)


def _moved_robot(
    problem: Problem, robot: RobotState, name: str, step: Array, moves: Array | None
) -> RobotState:
    layout, chain = problem.layout, problem.chains[name]
    disturbance = np.zeros((len(chain), 6))
    if moves is not None:
        disturbance[:-1, chain.tangent] = moves
    disturbance[-1, chain.tangent] = step[layout.last[name]]
    moved = replace(robot, map_from_base=robot.map_from_base.moved(disturbance))
    if name in layout.scales:
        moved = replace(moved, scales=robot.scales + step[layout.scales[name]])
    if name in layout.faces:
        faces = robot.base_from_face.disturbed(step[layout.faces[name]].reshape(-1, 6))
        moved = replace(moved, base_from_face=faces)
    return moved
