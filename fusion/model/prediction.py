"""The residuals of sightings and of odometry at a state, and their derivatives.

Every pose is disturbed by the contract's convention: t' = t + δt, R' = Exp(δθ) R in the parent's
axes.
"""

from dataclasses import dataclass

import numpy as np

from trigpoint.geometry import Pose
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import relative_jacobians
from trigpoint.native.library import In, Kernel, Out

from .motion import Motion
from .problem import Batch, Problem, State
from .projection import many

_NO_TWISTS = np.empty((0, 6))
_REAL = np.float64
_BATCH = (
    In(_REAL, ("p",)),
    *(In(_REAL, (1, 3, 3)), In(_REAL, (1, 3))),
    *(In(_REAL, ("n", 3, 3)), In(_REAL, ("n", 3))),
    *(In(_REAL, ("n", 3, 3)), In(_REAL, ("n", 3))),
    *(In(_REAL, ("f", 3, 3)), In(_REAL, ("f", 3))),
    In(np.int64, ("n", "k")),
    In(_REAL, ("n", "k", 3)),
    In(_REAL, ("n", "k", 2)),
    In(_REAL, ("n", "k")),
    In(_REAL, ("t", 6)),
    In(_REAL, ("n",)),
    In(np.int64, ("d",)),
    *(int, int),
)
_TERMS = Kernel(
    "tp_corner_terms",
    *_BATCH,
    Out(_REAL, ("n", "k", 2)),
    Out(_REAL, ("n", "k", "c")),
    Out(_REAL, ("n", "k", "s")),
)
_EQUATIONS = Kernel(
    "tp_corner_equations",
    *_BATCH,
    In(_REAL, ("j", 6)),
    float,
    Out(_REAL, ("n", "c", "c")),
    Out(_REAL, ("n", "c")),
    Out(_REAL, (2,)),
)
_NO_JITTER = np.empty((0, 6))


def batch_residual(batch: Batch, state: State) -> Array:
    """`batch_jacobian`'s residual alone, (n, K, 2)."""
    return _terms(batch, state)[0]


def batch_jacobian(problem: Problem, batch: Batch, state: State) -> tuple[Array, Array, np.ndarray]:
    """Weighted Jacobian (n, K, 2, d + q), residual (n, K, 2) and dense columns (q,) of a batch.

    Residual = (projection - pixel)/sigma. The first d columns are the node's; the dense ones begin
    with the camera's pose.
    """
    residual, jacobian, _ = _terms(batch, state, problem)
    return jacobian, residual, _dense_columns(problem, batch)


def batch_jacobians(
    problem: Problem, batch: Batch, state: State
) -> tuple[Array, Array, np.ndarray, Array]:
    """`batch_jacobian` and `base_jacobian` of one batch."""
    residual, jacobian, by_seen = _terms(batch, state, problem, by_seen=True)
    return jacobian, residual, _dense_columns(problem, batch), by_seen


def base_jacobian(batch: Batch, state: State) -> Array:
    """Weighted derivative (n, K, 2, 6) of `batch_residual` by a disturbance of the robot's pose
    when it was seen, in the map's axes."""
    return _terms(batch, state, by_seen=True)[2]


def _dense_columns(problem: Problem, batch: Batch) -> np.ndarray:
    """The columns of a batch's Jacobian but for the node's, in the order of the core."""
    layout = problem.layout
    columns = [layout.pose[batch.camera]]
    if batch.camera in layout.lens:
        columns.append(layout.lens[batch.camera])
    if batch.carried is not None:
        columns.append(layout.time_offset[batch.camera])
    if batch.robot in layout.faces:
        columns.append(layout.faces[batch.robot])
    return np.concatenate(columns)


def corner_equations(
    problem: Problem, batch: Batch, state: State, huber: float
) -> tuple[Array, Array, np.ndarray, tuple[float, float]]:
    """The normal equations of each picture of a batch: Hessian (n, d + q, d + q) and gradient
    (n, d + q) in the columns of `batch_jacobian`, the dense ones (q,), and the cost and
    ln |covariance| of all. Corners beyond `huber` sigmas have a linear cost (Huber); the robot's
    deviation in a picture is eliminated about its best fit, since what is left of a tilt has the
    same sign in all pictures."""
    columns = _dense_columns(problem, batch)
    tangent = problem.chains[batch.robot].tangent
    count, size = len(batch.nodes), len(tangent) + len(columns)
    hessian, gradient, score = np.empty((count, size, size)), np.empty((count, size)), np.empty(2)
    jitter = _NO_JITTER if batch.jitter is None else np.ascontiguousarray(batch.jitter)
    given = _given(batch, state, problem)
    _EQUATIONS(*given, jitter, float(huber), hessian, gradient, score)
    cost, log_determinant = score.tolist()
    return hessian, gradient, columns, (cost, log_determinant)


def _terms(
    batch: Batch,
    state: State,
    problem: Problem | None = None,
    *,
    by_seen: bool = False,
) -> tuple[Array, Array, Array]:
    """Residual (n, K, 2), Jacobian (n, K, 2, c) by the unknowns of a problem, and the derivative
    (n, K, 2, 6) by the robot as it was seen: the last two without columns where not asked for."""
    shape, shape_seen, columns = batch.weights.shape, 12 if by_seen else 0, 0
    if problem is not None:
        columns = len(problem.chains[batch.robot].tangent) + len(_dense_columns(problem, batch))
    residual = np.empty((*shape, 2))
    jacobian, by_robot = np.empty((*shape, 2 * columns)), np.empty((*shape, shape_seen))
    _TERMS(*_given(batch, state, problem), residual, jacobian, by_robot)
    return (
        residual,
        jacobian.reshape(*shape, 2, columns),
        by_robot.reshape(*shape, 2, shape_seen // 2),
    )


def _given(batch: Batch, state: State, problem: Problem | None) -> tuple[object, ...]:
    """A batch at a state as the core takes it."""
    camera, robot = state.cameras[batch.camera], state.robots[batch.robot]
    node = robot.map_from_base[batch.nodes]
    seen, twists = node, _NO_TWISTS
    if batch.carried is not None:
        seen = node @ batch.carried.at(camera.offset_s(batch.since_epoch_s))
        twists = np.ascontiguousarray(batch.carried.twists)
    return (
        camera.lens.parameters,
        *many(camera.map_from_camera, (1,)),
        *many(node, (len(node),)),
        *many(seen, (len(node),)),
        *many(robot.base_from_face, (len(robot.base_from_face),)),
        *map(np.ascontiguousarray, (batch.faces, batch.face_points, batch.pixels, batch.weights)),
        twists,
        np.ascontiguousarray(batch.since_epoch_s),
        np.array(() if problem is None else problem.chains[batch.robot].tangent, dtype=np.int64),
        problem is not None and batch.camera in problem.layout.lens,
        problem is not None and batch.robot in problem.layout.faces,
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

    A disturbance of R_iᵀ R_j turns r by J_l⁻¹(r) (Solà et al.), one of ΔR by -J_r⁻¹(r), where
    J_r(r) = J_l(-r).
    """
    residual = (earlier.inverse() @ later).difference(motion.earlier_from_later)
    turn = residual[:, 3:]
    by_earlier, by_later = relative_jacobians(earlier, later)
    inverse = np.linalg.inv(so3.left_jacobian(turn))
    turning = inverse @ by_later[:, 3:, 3:]
    by_earlier[:, 3:, 3:], by_later[:, 3:, 3:] = -turning, turning
    by_scale = -motion.by_scale
    by_scale[:, 3:] = np.swapaxes(inverse, 1, 2) @ by_scale[:, 3:]  # J_l(-r) = J_l(r)ᵀ
    free = np.ix_(range(len(residual)), tangent, tangent)
    whitening = np.linalg.inv(np.linalg.cholesky(motion.covariance[free]))
    return OdometryTerms(
        (whitening @ residual[:, tangent, None])[..., 0],
        whitening @ by_earlier[free],
        whitening @ by_later[free],
        whitening @ by_scale[:, tangent],
    )
