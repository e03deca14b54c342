"""The smoother's least-squares problem: its data, its unknowns, and its normal equations.

Unknowns are the robots' poses at their sightings («nodes», a chain per robot, held by odometry)
and the dense part: cameras, and where they have a prior sigma lenses, time offsets, odometry
scales and the faces' poses. A camera sees one robot at a time, so the normal equations are

    [A  B ] [nodes]     A: block-tridiagonal, one block row a node
    [Bᵀ C ] [dense]     C: small and dense

Every pose is disturbed by the contract's convention: t' = t + δt, R' = Exp(δθ) R in the parent's
axes; a planar robot by x, y and heading alone. The last node of each robot is in the dense part, so
that what is left after the chains are eliminated is what a filter would know.
"""

from dataclasses import dataclass

import numpy as np

from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.rotation import Array

from .odometry_track import PLANAR, SPATIAL, Motion

# Information of a pose that is known exactly: 0.3 µm and µrad.
EXACT = 1e13


@dataclass(frozen=True, slots=True)
class CameraState:
    """What is believed of one camera."""

    map_from_camera: Pose
    lens: CameraModel
    time_offset_s: float = 0.0


@dataclass(frozen=True, slots=True)
class RobotState:
    """What is believed of one robot: its nodes (n) in the map, its scales (2,), its faces."""

    map_from_base: Pose
    scales: Array
    base_from_face: Pose


@dataclass(frozen=True, slots=True)
class State:
    """Everything that is worked out."""

    cameras: dict[str, CameraState]
    robots: dict[str, RobotState]


@dataclass(frozen=True, slots=True)
class Chain:
    """One robot's nodes and the motion between them.

    `is_anchored`: node 0 is known exactly (the map's origin). `velocity`: (n, 6), base frame.
    `scales`: those at which `motion` was worked out.
    """

    robot: str
    stamps_ns: np.ndarray
    motion: Motion | None
    velocity: Array
    scales: Array
    planar: bool
    is_anchored: bool

    @property
    def tangent(self) -> list[int]:
        """Which of the six disturbances are free."""
        return PLANAR if self.planar else SPATIAL

    def __len__(self) -> int:
        return len(self.stamps_ns)


@dataclass(frozen=True, slots=True)
class Batch:
    """All used observations of one robot by one camera, padded to one size K.

    `nodes` (n,), `face_points` (n, K, 3), `faces` (n, K), `pixels` (n, K, 2), `weights` (n, K):
    1/sigma times the root of the share, 0 for padding and outliers; `shares` (n,): how much each
    observation counts; `sources` (n,): index into the data set;
    `time_offset_s`: the one that gave the nodes their times.
    """

    camera: str
    robot: str
    nodes: np.ndarray
    face_points: Array
    faces: np.ndarray
    pixels: Array
    weights: Array
    shares: Array
    sources: np.ndarray
    time_offset_s: float


@dataclass(frozen=True, slots=True)
class Priors:
    """Gaussian knowledge from before, as (column, expected disturbance)-free standard forms.

    `lens`: camera -> (parameters, sigmas); `time_offset`: camera -> sigma; `scales`: robot -> (2,)
    sigmas; `faces`: robot -> (base_from_face, translation sigma, rotation sigma); `cameras`: known
    poses by name with their joint information (6n, 6n), in the order of the dict.
    """

    lens: dict[str, tuple[Array, Array]]
    time_offset: dict[str, float]
    scales: dict[str, Array]
    faces: dict[str, tuple[Pose, float, float]]
    cameras: dict[str, Pose]
    camera_information: Array


@dataclass(frozen=True, slots=True)
class Layout:
    """Columns of the dense part by name; `size` of them."""

    pose: dict[str, slice]
    lens: dict[str, slice]
    time_offset: dict[str, slice]
    scales: dict[str, slice]
    faces: dict[str, slice]
    last: dict[str, slice]
    size: int


@dataclass(frozen=True, slots=True)
class Problem:
    """The data of one solution."""

    chains: dict[str, Chain]
    batches: tuple[Batch, ...]
    priors: Priors
    layout: Layout


@dataclass(slots=True)
class ChainEquations:
    """Normal equations of one chain's inner nodes, n of them."""

    diagonal: Array  # (n, d, d)
    lower: Array  # (n, d, d); [i]: node i + 1 by node i
    coupling: Array  # (n, d, dense)
    gradient: Array  # (n, d)


@dataclass(slots=True)
class NormalEquations:
    """Half the Hessian and the gradient of the cost Σ|r/σ|² at a state."""

    chains: dict[str, ChainEquations]
    dense: Array
    gradient: Array
    cost: float


def layout_of(cameras: list[str], chains: dict[str, Chain], priors: Priors, state: State) -> Layout:
    """Give every dense unknown its columns."""
    size = 0

    def take(count: int) -> slice:
        nonlocal size
        size += count
        return slice(size - count, size)

    pose = {name: take(6) for name in cameras}
    lens = {
        name: take(len(state.cameras[name].lens.parameters))
        for name in cameras
        if name in priors.lens
    }
    time_offset = {name: take(1) for name in cameras if name in priors.time_offset}
    scales = {name: take(2) for name in chains if name in priors.scales}
    faces = {name: take(6 * len(priors.faces[name][0])) for name in chains if name in priors.faces}
    last = {name: take(len(chain.tangent)) for name, chain in chains.items()}
    return Layout(pose, lens, time_offset, scales, faces, last, size)


def inner_nodes(chain: Chain) -> slice:
    """All nodes but the last."""
    return slice(0, len(chain) - 1)


def linearise(problem: Problem, state: State, *, huber: float = np.inf) -> NormalEquations:
    """The normal equations at a state; corners beyond `huber` sigmas count linearly."""
    size = problem.layout.size
    equations = NormalEquations({}, np.zeros((size, size)), np.zeros(size), 0.0)
    for name, chain in problem.chains.items():
        nodes = inner_nodes(chain)
        count, d = nodes.stop - nodes.start, len(chain.tangent)
        equations.chains[name] = ChainEquations(
            np.zeros((count, d, d)),
            np.zeros((count, d, d)),
            np.zeros((count, d, size)),
            np.zeros((count, d)),
        )
        _add_odometry(equations, problem, chain, state.robots[name])
        if chain.is_anchored:
            _hold_first(equations, problem, chain)
    for batch in problem.batches:
        _add_batch(equations, problem, batch, state, huber)
    _add_priors(equations, problem, state)
    return equations


def _hold_first(equations: NormalEquations, problem: Problem, chain: Chain) -> None:
    """Node 0 stays where it starts."""
    free = np.arange(len(chain.tangent))
    if len(chain) > 1:
        equations.chains[chain.robot].diagonal[0, free, free] += EXACT
    else:
        last = np.arange(problem.layout.size)[problem.layout.last[chain.robot]]
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
    d, inner = len(chain.tangent), inner_nodes(chain)
    equations.dense[np.ix_(columns, columns)] += hessian[:, d:, d:].sum(axis=0)
    equations.gradient[columns] += gradient[:, d:].sum(axis=0)
    is_inner = (nodes >= inner.start) & (nodes < inner.stop)
    rows = nodes[is_inner] - inner.start
    np.add.at(target.diagonal, rows, hessian[is_inner, :d, :d])
    np.add.at(target.gradient, rows, gradient[is_inner, :d])
    coupling = np.zeros((len(rows), d, problem.layout.size))
    coupling[:, :, columns] = hessian[is_inner, :d, d:]
    np.add.at(target.coupling, rows, coupling)
    is_last = nodes == len(chain) - 1
    if np.any(is_last):
        last = np.arange(problem.layout.size)[problem.layout.last[robot]]
        both = np.concatenate([last, columns])
        total = hessian[is_last].sum(axis=0)
        total[d:, d:] = 0
        equations.dense[np.ix_(both, both)] += total
        equations.gradient[last] += gradient[is_last, :d].sum(axis=0)


def _add_batch(
    equations: NormalEquations, problem: Problem, batch: Batch, state: State, huber: float
) -> None:
    jacobian, residual, columns = batch_jacobian(problem, batch, state)
    with np.errstate(invalid="ignore"):
        length = np.linalg.norm(residual, axis=-1)
    weight = np.minimum(1.0, huber / np.maximum(length, 1e-12))
    equations.cost += float(np.sum(np.where(weight < 1, huber * (2 * length - huber), length**2)))
    root = np.sqrt(weight)[..., None]
    n, _, _, q = jacobian.shape
    flat = (jacobian * root[..., None]).reshape(n, -1, q)
    transposed = np.swapaxes(flat, 1, 2)
    hessian = transposed @ flat
    gradient = (transposed @ (residual * root).reshape(n, -1, 1))[..., 0]
    _scatter(equations, problem, batch.robot, batch.nodes, hessian, gradient, columns)


def batch_jacobian(problem: Problem, batch: Batch, state: State) -> tuple[Array, Array, np.ndarray]:
    """Weighted Jacobian (n, K, 2, d + q), residual (n, K, 2) and dense columns (q,) of a batch.

    Residual = (projection - pixel)/sigma. With p the corner in the map and o in the optical frame,
    o = R_cᵀ(p - t_c): ∂o/∂δt_c = -R_cᵀ, ∂o/∂δθ_c = R_cᵀ[p - t_c]×, ∂p/∂δt_b = I,
    ∂p/∂δθ_b = -[R_b p_b]×, and likewise for a face on the base.
    """
    camera, robot = state.cameras[batch.camera], state.robots[batch.robot]
    chain, layout = problem.chains[batch.robot], problem.layout
    base_from_face = robot.base_from_face[batch.faces]
    in_face_axes = (base_from_face.rotation @ batch.face_points[..., None])[..., 0]
    in_base = in_face_axes + base_from_face.translation
    node = robot.map_from_base[batch.nodes]
    # True time = stamp - offset: a larger offset looks at the robot earlier on its way.
    twist = chain.velocity[batch.nodes].reshape(-1, 2, 3)
    by_offset = -(twist @ np.swapaxes(node.rotation, 1, 2)).reshape(-1, 6)
    node = node.disturbed(by_offset * (camera.time_offset_s - batch.time_offset_s))
    arm = in_base @ np.swapaxes(node.rotation, 1, 2)
    from_camera = arm + node.translation[:, None] - camera.map_from_camera.translation
    camera_rotation = camera.map_from_camera.rotation
    optical = from_camera @ camera_rotation
    # A corner behind the camera has no projection: it is pushed back before it, where its residual
    # is large and its derivative harmless.
    optical[..., 2] = np.where(batch.weights > 0, np.maximum(optical[..., 2], 1e-2), 1.0)
    pixels, by_optical, by_lens = camera.lens.project_jacobians(optical)
    weights = batch.weights[..., None]
    residual = (pixels - batch.pixels) * weights
    by_map = (by_optical @ camera_rotation.T) * weights[..., None]
    by_node = np.concatenate([by_map, -by_map @ so3.hat(arm)], axis=-1)
    parts = [
        by_node[..., chain.tangent],
        np.concatenate([-by_map, by_map @ so3.hat(from_camera)], axis=-1),
    ]
    columns = [layout.pose[batch.camera]]
    if batch.camera in layout.lens:
        parts.append(by_lens * weights[..., None])
        columns.append(layout.lens[batch.camera])
    if batch.camera in layout.time_offset:
        parts.append(by_node @ by_offset[:, None, :, None])
        columns.append(layout.time_offset[batch.camera])
    if batch.robot in layout.faces:
        by_base = by_map @ node.rotation[:, None]
        by_face = np.concatenate([by_base, -by_base @ so3.hat(in_face_axes)], axis=-1)
        count = len(robot.base_from_face)
        mine = batch.faces[..., None] == np.arange(count)
        parts.append(
            (by_face[..., None, :] * mine[..., None, :, None]).reshape(*by_face.shape[:3], -1)
        )
        columns.append(layout.faces[batch.robot])
    every = np.arange(layout.size)
    return (
        np.concatenate(parts, axis=-1),
        residual,
        np.concatenate([every[column] for column in columns]),
    )


@dataclass(frozen=True, slots=True)
class OdometryTerms:
    """Whitened residual (n, d) between consecutive nodes, and its derivatives."""

    residual: Array
    by_earlier: Array
    by_later: Array
    by_scale: Array


def odometry_terms(earlier: Pose, later: Pose, motion: Motion, tangent: list[int]) -> OdometryTerms:
    """Odometry's residual: t = R_iᵀ(t_j - t_i) - Δt, r = Log(R_iᵀ R_j ΔRᵀ), whitened.

    Disturbances turn it by ∂t/∂δθ_i = R_iᵀ[t_j - t_i]×, ∂r/∂δθ = J_l⁻¹(r) R_iᵀ (Solà et al.), and
    one of ΔR by -J_r⁻¹(r), where J_r(r) = J_l(-r).
    """
    to_earlier = np.swapaxes(earlier.rotation, 1, 2)
    between = later.translation - earlier.translation
    reported = motion.earlier_from_later
    turn = so3.log(to_earlier @ later.rotation @ np.swapaxes(reported.rotation, 1, 2))
    moved = (to_earlier @ between[..., None])[..., 0] - reported.translation
    turning = np.linalg.inv(so3.left_jacobian(turn)) @ to_earlier
    n = len(between)
    by_later = np.zeros((n, 6, 6))
    by_later[:, :3, :3] = to_earlier
    by_later[:, 3:, 3:] = turning
    by_earlier = -by_later
    by_earlier[:, :3, 3:] = to_earlier @ so3.hat(between)
    by_scale = -motion.by_scale
    by_scale[:, 3:] = np.linalg.solve(so3.left_jacobian(-turn), by_scale[:, 3:])
    residual = np.concatenate([moved, turn], axis=1)[:, tangent]
    free = np.ix_(range(n), tangent, tangent)
    root = np.linalg.cholesky(motion.covariance[free])
    solve = np.linalg.solve
    return OdometryTerms(
        solve(root, residual[..., None])[..., 0],
        solve(root, by_earlier[free]),
        solve(root, by_later[free]),
        solve(root, by_scale[:, tangent]),
    )


def _add_odometry(
    equations: NormalEquations, problem: Problem, chain: Chain, robot: RobotState
) -> None:
    if chain.motion is None:
        return
    nodes = robot.map_from_base
    motion = chain.motion.rescaled(robot.scales - chain.scales)
    terms = odometry_terms(nodes[:-1], nodes[1:], motion, chain.tangent)
    equations.cost += float(np.sum(terms.residual**2))
    layout, d = problem.layout, len(chain.tangent)
    columns = np.arange(layout.size)[layout.scales.get(chain.robot, slice(0, 0))]
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
    """Add (later by earlier) blocks (n, d, d): inside the chain, and from it to the last node."""
    inner = inner_nodes(chain)
    target = equations.chains[chain.robot]
    count = inner.stop - inner.start
    if count == 0:
        return
    inside = blocks[inner.start : inner.stop - 1]
    target.lower[: len(inside)] += inside
    last = problem.layout.last[chain.robot]
    target.coupling[count - 1][:, last] += blocks[-1].T


def _add_priors(equations: NormalEquations, problem: Problem, state: State) -> None:
    priors, layout = problem.priors, problem.layout
    for name, (expected, sigma) in priors.lens.items():
        columns = layout.lens[name]
        _add_diagonal(equations, columns, state.cameras[name].lens.parameters - expected, sigma)
    for name, sigma in priors.time_offset.items():
        offset = np.array([state.cameras[name].time_offset_s])
        _add_diagonal(equations, layout.time_offset[name], offset, np.array([sigma]))
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
    """The joint prior; an error e turns with its camera by ∂Log/∂δθ = J_l⁻¹(e)."""
    priors, layout = problem.priors, problem.layout
    error = np.stack(
        [state.cameras[name].map_from_camera.difference(p) for name, p in priors.cameras.items()]
    )
    every = np.arange(layout.size)
    columns = np.concatenate([every[layout.pose[name]] for name in priors.cameras])
    jacobian = np.eye(error.size)
    for index, turn in enumerate(error[:, 3:]):
        rows = slice(6 * index + 3, 6 * index + 6)
        jacobian[rows, rows] = np.linalg.inv(so3.left_jacobian(turn))
    pull = priors.camera_information @ error.reshape(-1)
    hessian = jacobian.T @ priors.camera_information @ jacobian
    equations.dense[np.ix_(columns, columns)] += hessian
    equations.gradient[columns] += jacobian.T @ pull
    equations.cost += float(error.reshape(-1) @ pull)


def _add_diagonal(equations: NormalEquations, columns: slice, error: Array, sigma: Array) -> None:
    """A prior with independent sigmas; a sigma of 0 holds the unknown where it is."""
    held = sigma <= 0
    variance = np.where(held, 1e-18, np.where(held, 1.0, sigma) ** 2)
    every = np.arange(len(equations.gradient))[columns]
    equations.dense[every, every] += 1 / variance
    equations.gradient[every] += error / variance
    equations.cost += float(np.sum(error**2 / variance))
