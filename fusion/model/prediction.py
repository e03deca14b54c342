"""The residuals of sightings and of odometry at a state, and their derivatives.

Every pose is disturbed by the contract's convention: t' = t + δt, R' = Exp(δθ) R in the parent's
axes.
"""

import numpy as np
from msgspec import Struct
from numpy.linalg import LinAlgError

from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.samples import unique
from trigpoint.native.library import In, Kernel, Out

from .motion import Motion
from .problem import Batch, Problem, State

_NO_TWISTS = np.empty((0, 6))
_REAL = np.float64
_PICTURES = (
    In(_REAL, ("p",)),
    In(_REAL, (1, 12)),
    *(In(_REAL, ("n", 12)), In(_REAL, ("n", 12)), In(_REAL, ("f", 12))),
    In(np.int64, ("n", "k")),
    In(_REAL, ("n", "k", 3)),
    In(_REAL, ("n", "k", 2)),
    In(_REAL, ("n", "k")),
    In(_REAL, ("t", 6)),
    In(_REAL, ("n",)),
    In(np.int64, ("d",)),
    int,
    In(np.int64, ("e",)),
)
_TERMS = Kernel(
    *("tp_corner_terms", *_PICTURES),
    *(Out(_REAL, ("n", "k", 2)), Out(_REAL, ("n", "k", "c"))),
)
_FACTOR = Kernel("tp_corner_factor", *_PICTURES, In(_REAL, ("v",)), Out(_REAL, ("q", "q")))
_ODOMETRY = Kernel(
    "tp_odometry_terms",
    *(In(_REAL, ("n", 12)), In(_REAL, ("n", 12)), In(_REAL, ("n", 12))),
    *(In(_REAL, ("n", 6, 6)), In(_REAL, ("n", 6, 2)), In(np.int64, ("d",))),
    Out(_REAL, ("n", "d")),
    *(Out(_REAL, ("n", "d", "d")), Out(_REAL, ("n", "d", "d")), Out(_REAL, ("n", "d", 2))),
)


def batch_residual(batch: Batch, state: State) -> Array:
    """`batch_jacobian`'s residual alone, (n, K, 2)."""
    return _terms(batch, state)[0]


def batch_jacobian(problem: Problem, batch: Batch, state: State) -> tuple[Array, Array, np.ndarray]:
    """Weighted Jacobian (n, K, 2, d + q), residual (n, K, 2) and dense columns (q,) of a batch.

    Residual = (projection - pixel)/sigma. The first d columns are the node's; the dense ones begin
    with the camera's pose.
    """
    residual, jacobian = _terms(batch, state, problem)
    return jacobian, residual, _dense_columns(problem, batch)


def picture_factor(problem: Problem, batch: Batch, state: State) -> tuple[Array, np.ndarray]:
    """The triangular factor (d + q + 1, d + q + 1) of one picture's equations of unit noise, in the
    d components of its node, q dense unknowns, of the faces those that it shows, and, last, the
    residual; and the columns (q,) of those. What the robot deviates from its node in it is
    eliminated, about its best fit."""
    faces = unique(batch.faces)
    columns = _dense_columns(problem, batch, faces)
    size = len(problem.chains[batch.robot].tangent) + len(columns) + 1
    factor = np.empty((size, size))
    variances = np.empty(0) if batch.jitter is None else batch.jitter.reshape(-1)
    _FACTOR(*_given(batch, state, problem, faces), np.ascontiguousarray(variances), factor)
    return factor, columns


def _dense_columns(problem: Problem, batch: Batch, faces: np.ndarray | None = None) -> np.ndarray:
    """The columns of a batch's Jacobian but for the node's, in the order of the core; `faces`: of
    the robot's, where not all."""
    layout = problem.layout
    columns = [layout.pose[batch.camera]]
    if batch.camera in layout.lens:
        columns.append(layout.lens[batch.camera])
    if batch.carried is not None:
        columns.append(layout.time_offset[batch.camera])
    if batch.robot in layout.faces:
        mine = layout.faces[batch.robot].reshape(-1, 6)
        columns.append((mine if faces is None else mine[faces]).reshape(-1))
    return np.concatenate(columns)


def _terms(batch: Batch, state: State, problem: Problem | None = None) -> tuple[Array, Array]:
    """Residual (n, K, 2) and Jacobian (n, K, 2, c) by the unknowns of a problem; without columns
    where there is none."""
    shape, columns = batch.weights.shape, 0
    if problem is not None:
        columns = len(problem.chains[batch.robot].tangent) + len(_dense_columns(problem, batch))
    residual, jacobian = np.empty((*shape, 2)), np.empty((*shape, 2 * columns))
    _TERMS(*_given(batch, state, problem), residual, jacobian)
    return residual, jacobian.reshape(*shape, 2, columns)


def _given(
    batch: Batch, state: State, problem: Problem | None, faces: np.ndarray | None = None
) -> tuple[object, ...]:
    """A batch at a state as the core takes it; `faces`: see `_dense_columns`."""
    camera, robot = state.cameras[batch.camera], state.robots[batch.robot]
    if problem is None or batch.robot not in problem.layout.faces:
        faces = np.arange(0)
    elif faces is None:
        faces = np.arange(len(robot.base_from_face))
    node = robot.map_from_base[batch.nodes]
    seen, twists = node, _NO_TWISTS
    if batch.carried is not None:
        seen = node @ batch.carried.at(camera.offset_s(batch.since_epoch_s))
        twists = np.ascontiguousarray(batch.carried.twists)
    return (
        camera.lens.parameters,
        *(camera.map_from_camera.rows(), node.rows(), seen.rows(), robot.base_from_face.rows()),
        *map(np.ascontiguousarray, (batch.faces, batch.face_points, batch.pixels, batch.weights)),
        twists,
        np.ascontiguousarray(batch.since_epoch_s),
        np.array(() if problem is None else problem.chains[batch.robot].tangent, dtype=np.int64),
        problem is not None and batch.camera in problem.layout.lens,
        faces,
    )


class OdometryTerms(Struct, frozen=True):
    """Whitened residual (n, d) between consecutive nodes, and its derivatives."""

    residual: Array
    by_earlier: Array
    by_later: Array
    by_scale: Array


def odometry_terms(earlier: Pose, later: Pose, motion: Motion, tangent: list[int]) -> OdometryTerms:
    """Odometry's residual: t = R_iᵀ(t_j - t_i) - Δt, r = Log(R_iᵀ R_j ΔRᵀ), whitened.

    Raises LinAlgError where a covariance is not positive definite.
    """
    count, d = len(earlier), len(tangent)
    terms = OdometryTerms(
        np.empty((count, d)), np.empty((count, d, d)), np.empty((count, d, d)),
        np.empty((count, d, 2)),
    )  # fmt: skip
    is_determined = _ODOMETRY(
        *(earlier.rows(), later.rows(), motion.earlier_from_later.rows()),
        *map(np.ascontiguousarray, (motion.covariance, motion.by_scale)),
        np.array(tangent, dtype=np.int64),
        *(terms.residual, terms.by_earlier, terms.by_later, terms.by_scale),
    )
    if not is_determined:
        raise LinAlgError("a motion's covariance is not positive definite")
    return terms
