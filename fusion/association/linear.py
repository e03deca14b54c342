"""A visit linearised: where each part of its pictures by itself puts the robot."""

from dataclasses import dataclass, replace

import msgspec
import numpy as np

from trigpoint.fusion.model.assembly import Assembled
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.odometry import PARTS
from trigpoint.fusion.model.prediction import batch_jacobians, odometry_terms
from trigpoint.fusion.model.problem import Batch, Chain, Problem
from trigpoint.geometry.rotation import Array

_EXACT = 1e-9
HELD = 1e-6
"""Sigma (m, rad, s, and of scales) of what is known exactly: far below what any sighting resolves,
but not so small that next to a gap in odometry it is lost in a float's rounding."""
# A pose is not determined if the least eigenvalue of its scaled information is below this.
_FLAT = 1e-12


@dataclass(frozen=True, slots=True)
class Linear:
    """A visit's linear equations. The unknowns (u) are the robot's poses at the visit's pictures
    but the first, then the camera's pose (columns `camera` (6,)) and others.

    `shifts` (n, 6): the shift of the robot's pose that each part by itself asks for, with its
    covariance `own` (n, 6, 6) by the corners and its coefficients `by_unknowns` (n, 6, u);
    `parts` (n,): which of the parts asked for each is; `places` (n, 3): where the robot was;
    `steps` (m, d): the shift that odometry asks for, with coefficients `steps_by_unknowns`
    (m, d, u), covariance `spread` (m, d, d), and that due to the stated noise and skid
    (`by_odometry`) and to slip (`by_slip`) alone; `broken` (m, d, d): what is added to these
    covariances where something happened on the way; `prior` (u, u): the prior information on the
    unknowns.
    """

    shifts: Array
    own: Array
    by_unknowns: Array
    parts: list[int]
    places: Array
    steps: Array
    steps_by_unknowns: Array
    spread: Array
    by_odometry: Array
    by_slip: Array
    broken: Array
    prior: Array
    camera: np.ndarray


@dataclass(frozen=True, slots=True)
class _Columns:
    """The dense columns of one camera and robot in a problem: `dense` (the camera's own), and the
    robot's `scales` and `faces`. `place`: by column, its position among the visit's `count`
    unknowns."""

    dense: np.ndarray
    scales: np.ndarray
    faces: np.ndarray
    place: dict[int, int]
    count: int


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
    columns = _columns(problem, batch, len(chain.tangent) * (len(chain) - 1))
    jacobian, residual, names, by_base = batch_jacobians(problem, batch, state)
    d, shifts, own, by_unknowns, kept = len(chain.tangent), [], [], [], []
    for number, (row, part) in enumerate(parts):
        corners = slice(None) if part is None else part
        flat = by_base[row, corners].reshape(-1, 6)
        normal = flat.T @ flat
        scale = 1 / np.sqrt(np.maximum(np.diagonal(normal), _EXACT))
        values, vectors = np.linalg.eigh(normal * scale[:, None] * scale)
        if values[0] < _FLAT:
            continue
        root = scale[:, None] * vectors / np.sqrt(values)
        covariance = root @ root.T
        by = covariance @ (flat.T @ jacobian[row, corners].reshape(len(flat), -1))
        whole, node = np.zeros((6, columns.count)), int(batch.nodes[row])
        if node > 0:
            whole[:, d * (node - 1) : d * node] = by[:, :d]
        for source, column in enumerate(names):
            if column in columns.place:
                whole[:, columns.place[column]] = by[:, d + source]
        shifts.append(-covariance @ (flat.T @ residual[row, corners].reshape(-1)))
        own.append(covariance)
        by_unknowns.append(whole)
        kept.append(number)
    if len(shifts) < 2:
        return None
    nodes = len(chain) - 1
    whole_steps = replace(chain.motion, covariance=np.tile(np.eye(6), (nodes, 1, 1)))
    poses = state.robots[batch.robot].map_from_base
    terms = odometry_terms(poses[:-1], poses[1:], whole_steps, chain.tangent)
    steps = np.zeros((nodes, d, columns.count))
    for step in range(nodes):
        steps[step, :, d * step : d * (step + 1)] = terms.by_later[step]
        if step:
            steps[step, :, d * (step - 1) : d * step] = terms.by_earlier[step]
        for order, column in enumerate(columns.scales):
            steps[step, :, columns.place[column]] = terms.by_scale[step][:, order]
    free = np.ix_(range(nodes), chain.tangent, chain.tangent)
    return Linear(
        np.array(shifts),
        np.array(own),
        np.array(by_unknowns),
        kept,
        poses.translation[batch.nodes[[parts[number][0] for number in kept]]],
        -terms.residual,
        steps,
        chain.motion.covariance[free],
        *_step_covariances(data, chain),
        np.zeros((nodes, d, d)),
        _prior(problem, batch, columns),
        d * nodes + np.arange(6),
    )


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
    columns = _columns(problem, batch, 0)
    information = np.diagonal(_prior(problem, batch, columns))
    logs = np.log(np.where(information > 0, information, 1.0))
    own = [columns.place[name] for name in columns.dense]
    return float(logs[own].sum()), float(np.delete(logs, own).sum())


def _columns(problem: Problem, batch: Batch, before: int) -> _Columns:
    dense = unknowns_of(problem, batch.camera)
    scales = problem.layout.scales_of(batch.robot)
    faces = problem.layout.faces.get(batch.robot, np.arange(0))
    every = np.concatenate([dense, scales, faces]).tolist()
    place = {column: before + order for order, column in enumerate(every)}
    return _Columns(dense, scales, faces, place, before + len(every))


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
    """Return the prior information (u, u) on the unknowns."""
    priors, information = problem.priors, np.zeros(columns.count)

    def put(names: np.ndarray, sigma: Array) -> None:
        at = [columns.place[name] for name in names]
        information[at] = np.where(sigma > 0, sigma, HELD) ** -2.0

    layout = problem.layout
    if batch.camera in priors.lens:
        put(layout.lens[batch.camera], priors.lens[batch.camera][1])
    if batch.camera in priors.time_offset:
        put(layout.time_offset[batch.camera], priors.time_offset[batch.camera])
    if len(columns.scales):
        put(columns.scales, priors.scales[batch.robot])
    if len(columns.faces):
        expected, shift, turn = priors.faces[batch.robot]
        put(columns.faces, np.tile(np.repeat(np.array([shift, turn]), 3), len(expected)))
    return np.diag(information)
