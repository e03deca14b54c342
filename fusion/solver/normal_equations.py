"""The normal equations of a problem at a state: half the Hessian and the gradient of its cost."""

from dataclasses import dataclass, field

import numpy as np

from trigpoint.fusion.model.prediction import corner_equations, odometry_terms
from trigpoint.fusion.model.problem import Batch, Chain, Problem, RobotState, State
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.rotation import Array

# Information of a pose that is known exactly: 0.3 µm and µrad.
EXACT = 1e13


@dataclass(frozen=True, slots=True)
class Coupling:
    """Blocks (m, d, q) between inner nodes `rows` (m,) and dense `columns` (q,), to be summed."""

    rows: np.ndarray
    blocks: Array
    columns: np.ndarray


@dataclass(slots=True)
class ChainEquations:
    """Normal equations of one chain's inner nodes, n of them.

    A node is coupled with the few cameras that see it, so the blocks are kept by camera.
    """

    diagonal: Array  # (n, d, d)
    lower: Array  # (n, d, d); [i]: node i + 1 by node i
    gradient: Array  # (n, d)
    dense_size: int
    couplings: list[Coupling] = field(default_factory=list)

    @classmethod
    def zeros(cls, count: int, d: int, dense_size: int) -> "ChainEquations":
        return cls(
            np.zeros((count, d, d)), np.zeros((count, d, d)), np.zeros((count, d)), dense_size
        )

    @property
    def coupling(self) -> Array:
        """The coupling as one dense array, (n, d, dense)."""
        n, d = self.gradient.shape
        whole = np.zeros((n, d, self.dense_size))
        for part in self.couplings:
            if has_each_once(part.rows):
                whole[part.rows[:, None], :, part.columns] += np.moveaxis(part.blocks, 2, 1)
            else:
                at = (part.rows[:, None, None], np.arange(d)[:, None], part.columns)
                np.add.at(whole, at, part.blocks)
        return whole


@dataclass(slots=True)
class NormalEquations:
    """Half the Hessian and the gradient of the cost Σ|r/σ|² at a state; `log_determinant`: of the
    pictures' covariance with their jitter (`model/prediction.corner_equations`)."""

    chains: dict[str, ChainEquations]
    dense: Array
    gradient: Array
    cost: float
    log_determinant: float = 0.0


def linearise(problem: Problem, state: State, *, huber: float = np.inf) -> NormalEquations:
    """The normal equations at a state; corners beyond `huber` sigmas have a linear cost (Huber)."""
    size = problem.layout.size
    equations = NormalEquations({}, np.zeros((size, size)), np.zeros(size), 0.0)
    for name, chain in problem.chains.items():
        equations.chains[name] = ChainEquations.zeros(len(chain) - 1, len(chain.tangent), size)
        _add_odometry(equations, problem, chain, state.robots[name])
        if chain.is_anchored:
            _hold_first(equations, problem, chain)
    for batch in problem.batches:
        _add_batch(equations, problem, batch, state, huber)
    _add_priors(equations, problem, state)
    return equations


def _hold_first(equations: NormalEquations, problem: Problem, chain: Chain) -> None:
    """Fix node 0 at its initial pose."""
    free = np.arange(len(chain.tangent))
    if len(chain) > 1:
        equations.chains[chain.robot].diagonal[0, free, free] += EXACT
    else:
        last = problem.layout.last[chain.robot]
        equations.dense[last, last] += EXACT


def _scatter(
    equations: NormalEquations,
    problem: Problem,
    robot: str,
    nodes: np.ndarray,
    hessian: Array,
    gradient: Array,
    columns: np.ndarray,
) -> None:
    """Add terms (n, d + q, d + q) over one node each and the same dense columns (q,)."""
    chain, target = problem.chains[robot], equations.chains[robot]
    d, last_node = len(chain.tangent), len(chain) - 1
    equations.dense[np.ix_(columns, columns)] += hessian[:, d:, d:].sum(axis=0)
    equations.gradient[columns] += gradient[:, d:].sum(axis=0)
    is_inner = nodes < last_node
    rows = nodes[is_inner]
    if has_each_once(rows):
        target.diagonal[rows] += hessian[is_inner, :d, :d]
        target.gradient[rows] += gradient[is_inner, :d]
    else:
        np.add.at(target.diagonal, rows, hessian[is_inner, :d, :d])
        np.add.at(target.gradient, rows, gradient[is_inner, :d])
    if len(rows) and len(columns):
        target.couplings.append(Coupling(rows, hessian[is_inner, :d, d:], columns))
    is_last = nodes == last_node
    if np.any(is_last):
        last = problem.layout.last[robot]
        both = np.concatenate([last, columns])
        total = hessian[is_last].sum(axis=0)
        total[d:, d:] = 0
        equations.dense[np.ix_(both, both)] += total
        equations.gradient[last] += gradient[is_last, :d].sum(axis=0)


def has_each_once(rows: np.ndarray) -> bool:
    """Whether ascending rows are unique (a robot that stands may be seen twice at one node)."""
    return bool(np.all(np.diff(rows) > 0))


def _add_batch(
    equations: NormalEquations, problem: Problem, batch: Batch, state: State, huber: float
) -> None:
    hessian, gradient, columns, score = corner_equations(problem, batch, state, huber)
    equations.cost += score[0]
    equations.log_determinant += score[1]
    _scatter(equations, problem, batch.robot, batch.nodes, hessian, gradient, columns)


def _add_odometry(
    equations: NormalEquations, problem: Problem, chain: Chain, robot: RobotState
) -> None:
    if chain.motion is None:
        return
    nodes = robot.map_from_base
    motion = chain.motion.rescaled(robot.scales - chain.scales)
    terms = odometry_terms(nodes[:-1], nodes[1:], motion, chain.tangent)
    equations.cost += float(np.sum(terms.residual**2))
    columns, d = problem.layout.scales_of(chain.robot), len(chain.tangent)
    by_scale = terms.by_scale[..., : len(columns)]
    for by_node, offset in ((terms.by_earlier, 0), (terms.by_later, 1)):
        jacobian = np.concatenate([by_node, by_scale], axis=-1)
        transposed = np.swapaxes(jacobian, 1, 2)
        hessian = transposed @ jacobian
        gradient = (transposed @ terms.residual[..., None])[..., 0]
        if offset:  # the scales' own part is added once
            hessian[:, d:, d:] = 0
            gradient[:, d:] = 0
        order = np.arange(len(chain) - 1) + offset
        _scatter(equations, problem, chain.robot, order, hessian, gradient, columns)
    _add_between(equations, problem, chain, np.swapaxes(terms.by_later, 1, 2) @ terms.by_earlier)


def _add_between(equations: NormalEquations, problem: Problem, chain: Chain, blocks: Array) -> None:
    """Add the blocks (n, d, d) of later by earlier nodes: in the chain, and to the last node."""
    target, last = equations.chains[chain.robot], problem.layout.last[chain.robot]
    target.lower[:-1] += blocks[:-1]
    row = np.array([len(blocks) - 1])
    target.couplings.append(Coupling(row, blocks[-1:].swapaxes(1, 2), last))


def _add_priors(equations: NormalEquations, problem: Problem, state: State) -> None:
    priors, layout = problem.priors, problem.layout
    for name, (expected, sigma) in priors.lens.items():
        columns = layout.lens[name]
        _add_diagonal(equations, columns, state.cameras[name].lens.parameters - expected, sigma)
    for name, sigma in priors.time_offset.items():
        camera = state.cameras[name]
        offset = np.array([camera.time_offset_s, camera.time_drift])
        _add_diagonal(equations, layout.time_offset[name], offset, sigma)
    for name, sigma in priors.scales.items():
        _add_diagonal(equations, layout.scales[name], state.robots[name].scales, sigma)
    for name, (expected, translation, rotation) in priors.faces.items():
        columns = layout.faces[name]
        error = state.robots[name].base_from_face.difference(expected)
        sigma = np.tile(np.repeat([translation, rotation], 3), len(error))
        _add_diagonal(equations, columns, error.reshape(-1), sigma)
    if priors.cameras:
        _add_known_cameras(equations, problem, state)


def _add_known_cameras(equations: NormalEquations, problem: Problem, state: State) -> None:
    """Add the joint prior; the rotation error e has the derivative ∂Log/∂δθ = J_l⁻¹(e)."""
    priors, layout = problem.priors, problem.layout
    error = np.stack(
        [state.cameras[name].map_from_camera.difference(p) for name, p in priors.cameras.items()]
    )
    columns = np.concatenate([layout.pose[name] for name in priors.cameras])
    jacobian = np.eye(error.size)
    for index, turn in enumerate(error[:, 3:]):
        rows = slice(6 * index + 3, 6 * index + 6)
        jacobian[rows, rows] = np.linalg.inv(so3.left_jacobian(turn))
    pull = priors.camera_information @ error.reshape(-1)
    hessian = jacobian.T @ priors.camera_information @ jacobian
    equations.dense[np.ix_(columns, columns)] += hessian
    equations.gradient[columns] += jacobian.T @ pull
    equations.cost += float(error.reshape(-1) @ pull)


def _add_diagonal(
    equations: NormalEquations, columns: np.ndarray, error: Array, sigma: Array
) -> None:
    """Add a prior with independent sigmas; a sigma of 0 holds its unknown fixed."""
    held = sigma <= 0
    variance = np.where(held, 1e-18, np.where(held, 1.0, sigma) ** 2)
    equations.dense[columns, columns] += 1 / variance
    equations.gradient[columns] += error / variance
    equations.cost += float(np.sum(error**2 / variance))
