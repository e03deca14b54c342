"""Solves the smoother's problem: Levenberg-Marquardt steps by elimination of the chains.

The chains are eliminated (`elimination`) in a time linear in the number of nodes. What remains is
S = C - BᵀA⁻¹B, the marginal information of the dense part, and S⁻¹ its marginal covariance.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from trigpoint.fusion.model.problem import CameraState, Layout, Problem, RobotState, State
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import symmetric

from .elimination import Elimination, eliminated
from .normal_equations import NormalEquations, linearise

# Damping, relative to the diagonal, after a failed step. The bending of a long chain is so weakly
# determined beside its nodes that even the least damping suppresses it: after successful steps
# there is soon none.
_DAMPING_LEAST = 1e-6
_DAMPING_NONE = 1e-9
_DAMPING_END = 1e8


@dataclass(frozen=True, slots=True)
class Reduced:
    """The dense part after the chains are eliminated: information and gradient at a state."""

    layout: Layout
    information: Array
    gradient: Array

    def covariance(self) -> Array:
        """Joint covariance of the dense part; raise LinAlgError where it is not determined."""
        return covariance_of(self.information)


@dataclass(frozen=True, slots=True)
class Solution:
    """The state at the minimum, and the reduced information there."""

    state: State
    reduced: Reduced
    cost: float
    iterations: int
    has_converged: bool


def solve(
    problem: Problem,
    start: State,
    *,
    huber: float = np.inf,
    tolerance: float = 1e-6,
    most_iterations: int = 50,
) -> Solution:
    """Find the state of least cost near `start`.

    Has converged when the predicted decrease of the cost, a χ², is less than `tolerance`.
    """
    found = minimise(
        problem, start, huber=huber, tolerance=tolerance, most_iterations=most_iterations
    )
    reduced = reduce(problem, found.equations)
    cost = found.equations.cost
    return Solution(found.state, reduced, cost, found.iterations, found.has_converged)


@dataclass(frozen=True, slots=True)
class Minimum:
    """A state of least cost, and the normal equations there."""

    state: State
    equations: NormalEquations
    iterations: int
    has_converged: bool


def minimise(
    problem: Problem, start: State, *, huber: float, tolerance: float, most_iterations: int
) -> Minimum:
    """`solve` without the elimination at the end."""
    state, damping = start, 0.0
    equations = linearise(problem, state, huber=huber)
    iterations, has_converged = 0, False
    while iterations < most_iterations and damping < _DAMPING_END:
        iterations += 1
        try:
            step, promised, chains = _step(equations, damping)
        except LinAlgError:
            damping = max(damping * 100, _DAMPING_LEAST)
            continue
        if promised < tolerance:
            has_converged = True
            break
        moved = moved_state(problem, state, step, chains)
        candidate = linearise(problem, moved, huber=huber)
        if np.isfinite(candidate.cost) and candidate.cost <= equations.cost:
            state, equations = moved, candidate
            damping = damping / 30 if damping > _DAMPING_NONE else 0.0
        else:
            damping = max(damping * 30, _DAMPING_LEAST)
    return Minimum(state, equations, iterations, has_converged)


def reduce(problem: Problem, equations: NormalEquations) -> Reduced:
    """Eliminate the chains: the information and the gradient of the dense part."""
    information, gradient, _ = eliminate(equations, 0.0)
    return Reduced(problem.layout, information, gradient)


def covariance_of(information: Array) -> Array:
    """Inverse of an information matrix after scaling its diagonal to 1; raise LinAlgError where it
    is not positive definite."""
    scale = 1 / np.sqrt(np.maximum(np.diagonal(information), 1e-300))
    scaled = symmetric(information) * scale[:, None] * scale
    inverse = cho_solve(cho_factor(scaled, lower=True), np.eye(len(scaled)))
    return symmetric(inverse) * scale[:, None] * scale


def eliminate(
    equations: NormalEquations, damping: float
) -> tuple[Array, Array, dict[str, Elimination]]:
    """Information and gradient of the dense part after the chains' elimination, and the eliminated
    chains."""
    information, gradient = equations.dense.copy(), equations.gradient.copy()
    chains: dict[str, Elimination] = {}
    for name, chain in equations.chains.items():
        if len(chain.diagonal) == 0:
            continue
        chains[name] = eliminated(chain, equations.dense, damping)
        gradient += chains[name].gradient
        information += chains[name].information
    return symmetric(information), gradient, chains


def _step(equations: NormalEquations, damping: float) -> tuple[Array, float, dict[str, Array]]:
    """The damped step of the dense part, the predicted decrease of χ², and the chains' steps."""
    information, gradient, chains = eliminate(equations, damping)
    damped = information + np.diag(damping * np.abs(np.diagonal(information)))
    diagonal = np.diagonal(damped)
    if np.any(diagonal <= 0):
        raise LinAlgError("the equations are singular: an unknown is not determined")
    scale = 1 / np.sqrt(diagonal)
    factor = cho_factor(damped * scale[:, None] * scale, lower=True)
    step = -scale * cho_solve(factor, scale * gradient)
    nodes = {name: chain.nodes(step) for name, chain in chains.items()}
    promised = -float(equations.gradient @ step)
    for name, moves in nodes.items():
        promised -= float(np.sum(equations.chains[name].gradient * moves))
    return step, promised, nodes


def moved_state(
    problem: Problem, state: State, step: Array, chain_steps: dict[str, Array]
) -> State:
    """The state after a step of the dense part and of the chains' inner nodes."""
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
