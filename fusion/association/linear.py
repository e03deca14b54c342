"""A visit to first order: what every part of its pictures says of where the robot stood."""

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
"""Sigma (m, rad, s, and of scales) of what is known exactly: far below what any sighting tells, and
not so far that beside a gap in odometry nothing is left of it in a number's digits."""
# Of the eigenvalues of a scaled information: a pose is not determined.
_FLAT = 1e-12


@dataclass(frozen=True, slots=True)
class Linear:
    """Unknowns are the robot's poses at the visit's pictures but the first, then `camera`'s columns
    (6,) and others.

    `shifts` (n, 6): by how much each part by itself puts the robot otherwise, with `own` (n, 6, 6)
    its covariance by the corners and `by_unknowns` (n, 6, u); `parts` (n,): which of those asked
    for it is, and `places` (n, 3) where the robot was; `steps` (m, d): what odometry asks for, with
    `steps_by_unknowns` (m, d, u), its covariance `spread` (m, d, d), and that by the stated noise
    and by slip alone, `by_odometry` and `by_slip`; `broken` (m, d, d): what is added to these where
    something happened on the way; `prior` (u, u): information on the unknowns from before.
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
    """Of one camera and robot in the dense part: `dense` the camera's own, `scales`, `faces`;
    `place`: column -> where it stands among the visit's unknowns, of which there are `count`."""

    dense: np.ndarray
    scales: np.ndarray
    faces: np.ndarray
    place: dict[int, int]
    count: int


def linearised(
    data: DataSet, assembled: Assembled, batch: Batch, parts: list[tuple[int, slice | None]]
) -> Linear | None:
    """A problem of one batch about its start. `parts`: each a row of the batch and which of its
    corners, None: all; those that determine no pose are left out. None where fewer than two are
    left or the robot stood still."""
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
    """The dense columns of a camera: pose, lens, clock."""
    layout = problem.layout
    parts = [layout.pose[camera]]
    parts += [part[camera] for part in (layout.lens, layout.time_offset) if camera in part]
    return np.concatenate(parts)


def log_priors(problem: Problem, camera: str, robot: str) -> tuple[float, float]:
    """ln |information| from before: on a camera's own unknowns, and on the robot's scales and the
    places of its faces."""
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
    """The covariances (m, d, d) of a chain's steps by the stated noise and skid, and by slip."""
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
    """What is known of the unknowns from before (u, u)."""
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
