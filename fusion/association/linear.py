"""A visit linearised: where each part of its pictures by itself puts the robot."""

from dataclasses import dataclass, replace
from typing import Self

import msgspec
import numpy as np

from trigpoint.fusion.model.assembly import Assembled
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.odometry import PARTS
from trigpoint.fusion.model.prediction import batch_jacobians, odometry_terms
from trigpoint.fusion.model.problem import Batch, Chain, Problem
from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In

_EXACT = 1e-9
HELD = 1e-6
"""Sigma (m, rad, s, and of scales) of what is known exactly: far below what any sighting resolves,
but not so small that next to a gap in odometry it is lost in a float's rounding."""
# A pose is not determined if the least eigenvalue of its scaled information is below this.
_FLAT = 1e-12
_REAL = np.float64
EQUATIONS = (
    *(In(_REAL, ("n", 6)), In(_REAL, ("n", 6, 6)), In(np.int64, ("n",))),
    *(In(_REAL, ("n", 6, "d")), In(_REAL, ("n", 6, "q"))),
    *(In(_REAL, ("m", "d")), In(_REAL, ("m", "d", "d")), In(_REAL, ("m", "d", "d"))),
    *(In(_REAL, ("m", "d", "q")), In(_REAL, ("q",))),
)
"""Of a visit, as the core's kernels take them first."""


@dataclass(frozen=True, slots=True)
class Linear:
    """A visit's linear equations. The unknowns are the robot's poses (d) at the visit's m + 1
    nodes, but for the first, which is held, and what all equations may share: `others` (q), the
    first six of which are the camera's pose.

    `shifts` (n, 6): the shift of the robot's pose that each part by itself asks for, with its
    covariance `own` (n, 6, 6) by the corners and its coefficients `by_robot` (n, 6, d), of the pose
    at its node, and `by_others` (n, 6, q); `nodes` (n,): these nodes, in order; `parts` (n,): which
    of the parts asked for each is; `places` (n, 3): where the robot was; `steps` (m, d): the shift
    that odometry asks for from node to node, with coefficients `by_earlier`, `by_later` (m, d, d)
    and `steps_by_others` (m, d, q), covariance `spread` (m, d, d), and that due to the stated noise
    and skid (`by_odometry`) and to slip (`by_slip`) alone; `broken` (m, d, d): what is added to
    these covariances where something happened on the way; `prior` (q,): the prior information on
    the others.
    """

    shifts: Array
    own: Array
    nodes: np.ndarray
    by_robot: Array
    by_others: Array
    parts: list[int]
    places: Array
    steps: Array
    by_earlier: Array
    by_later: Array
    steps_by_others: Array
    spread: Array
    by_odometry: Array
    by_slip: Array
    broken: Array
    prior: Array

    @property
    def equations(self) -> tuple[Array, ...]:
        """What kernels take, as `EQUATIONS` says."""
        parts = self.shifts, self.own, self.nodes, self.by_robot, self.by_others
        return *parts, self.steps, self.by_earlier, self.by_later, self.steps_by_others, self.prior


@dataclass(frozen=True, slots=True)
class _Columns:
    """The dense columns of one camera and robot in a problem, the camera's `own` first, and then
    those of the robot's scales and faces: `every` (q,)."""

    every: list[int]
    own: int

    @classmethod
    def of(cls, problem: Problem, batch: Batch) -> Self:
        own = unknowns_of(problem, batch.camera)
        faces = problem.layout.faces.get(batch.robot, np.arange(0))
        every = np.concatenate([own, problem.layout.scales_of(batch.robot), faces])
        return cls(every.tolist(), len(own))

    def at(self, columns: np.ndarray) -> list[int]:
        """Where some of them are among them all."""
        return [self.every.index(column) for column in columns.tolist()]


def linearised(
    data: DataSet, assembled: Assembled, batch: Batch, parts: list[tuple[int, slice | None]]
) -> Linear | None:
    """Linearise a problem of one batch about its start; None if fewer than two parts are left or
    the robot stood still.

    `parts`: for each a row of the batch and which of its corners, None for all; those that
    determine no pose are left out.
    """
    problem, state = assembled.problem, assembled.start
    chain = problem.chains[batch.robot]
    if chain.motion is None:
        return None
    columns, d, nodes = _Columns.of(problem, batch), len(chain.tangent), len(chain) - 1
    jacobian, residual, names, by_base = batch_jacobians(problem, batch, state)
    rows = [row for row, _ in parts]
    is_asked = np.zeros((len(parts), residual.shape[1], 1, 1))
    for asked, (_, part) in zip(is_asked, parts, strict=True):
        asked[part or slice(None)] = 1.0
    across = np.swapaxes((is_asked * by_base[rows]).reshape(len(parts), -1, 6), 1, 2)
    covariance, is_determined = _inverses(across @ np.swapaxes(across, 1, 2))
    kept = np.flatnonzero(is_determined)
    if len(kept) < 2:
        return None
    own, reduced = covariance[kept], covariance[kept] @ across[kept]
    by = reduced @ jacobian[rows].reshape(len(parts), -1, jacobian.shape[-1])[kept]
    shifts = -(reduced @ residual[rows].reshape(len(parts), -1, 1)[kept])[..., 0]
    at = batch.nodes[rows][kept]
    by_others = np.zeros((len(kept), 6, len(columns.every)))
    by_others[..., columns.at(names)] = by[..., d:]
    # The covariances of the steps vary with the noise, so they are left apart.
    unit = replace(chain.motion, covariance=np.tile(np.eye(6), (nodes, 1, 1)))
    poses = state.robots[batch.robot].map_from_base
    terms = odometry_terms(poses[:-1], poses[1:], unit, chain.tangent)
    steps_by_others = np.zeros((nodes, d, len(columns.every)))
    scales = problem.layout.scales_of(batch.robot)
    steps_by_others[..., columns.at(scales)] = terms.by_scale[..., : len(scales)]
    free = np.ix_(range(nodes), chain.tangent, chain.tangent)
    return Linear(
        shifts,
        own,
        at,
        np.ascontiguousarray(by[..., :d]),
        by_others,
        kept.tolist(),
        poses.translation[at],
        -terms.residual,
        terms.by_earlier,
        terms.by_later,
        steps_by_others,
        chain.motion.covariance[free],
        *_step_covariances(data, chain),
        np.zeros((nodes, d, d)),
        _prior(problem, batch, columns),
    )


def _inverses(information: Array) -> tuple[Array, np.ndarray]:
    """The covariances (n, 6, 6) of poses by their information, and which are determined (n,)."""
    diagonal = np.diagonal(information, axis1=1, axis2=2)
    scale = 1 / np.sqrt(np.maximum(diagonal, _EXACT))
    values, vectors = np.linalg.eigh(information * scale[:, :, None] * scale[:, None])
    root = scale[:, :, None] * vectors / np.sqrt(np.maximum(values, _FLAT))[:, None]
    return root @ np.swapaxes(root, 1, 2), values[:, 0] >= _FLAT


def unknowns_of(problem: Problem, camera: str) -> np.ndarray:
    """Return the dense columns of a camera's unknowns: pose, lens, clock."""
    layout = problem.layout
    parts = [layout.pose[camera]]
    parts += [part[camera] for part in (layout.lens, layout.time_offset) if camera in part]
    return np.concatenate(parts)


def log_priors(problem: Problem, camera: str, robot: str) -> tuple[float, float]:
    """Return ln |prior information| of a camera's own unknowns, and of the robot's scales and the
    poses of its faces."""
    batch = next(b for b in problem.batches if (b.camera, b.robot) == (camera, robot))
    columns = _Columns.of(problem, batch)
    logs = np.log(_prior(problem, batch, columns)[6:])  # none is of the camera's pose
    own, others = np.split(logs, [columns.own - 6])
    return float(own.sum()), float(others.sum())


def _step_covariances(data: DataSet, chain: Chain) -> tuple[Array, Array]:
    """Return the covariances (m, d, d) of a chain's steps due to the stated noise and skid, and
    due to slip."""
    free = np.ix_(range(len(chain) - 1), chain.tangent, chain.tangent)
    noise = data.site.robots[chain.robot].odometry
    silent = msgspec.structs.replace(noise, **dict.fromkeys(PARTS, 0.0))
    found = []
    whole = chain.track
    for part, slip, skid in ((noise, 0.0, whole.skid), (silent, whole.slip, 0.0)):
        track = whole.noisy(part, slip=slip, skid=skid)
        found.append(track.motion(chain.stamps_ns, chain.scales).covariance[free])
    return found[0], found[1]


def _prior(problem: Problem, batch: Batch, columns: _Columns) -> Array:
    """Return the prior information (q,) on the columns."""
    priors, information = problem.priors, np.zeros(len(columns.every))

    def put(names: np.ndarray, sigma: Array) -> None:
        information[columns.at(names)] = np.where(sigma > 0, sigma, HELD) ** -2.0

    layout = problem.layout
    if batch.camera in priors.lens:
        put(layout.lens[batch.camera], priors.lens[batch.camera][1])
    if batch.camera in priors.time_offset:
        put(layout.time_offset[batch.camera], priors.time_offset[batch.camera])
    if batch.robot in priors.scales:
        put(layout.scales[batch.robot], priors.scales[batch.robot])
    if batch.robot in priors.faces:
        expected, shift, turn = priors.faces[batch.robot]
        put(
            layout.faces[batch.robot], np.tile(np.repeat(np.array([shift, turn]), 3), len(expected))
        )
    return information
