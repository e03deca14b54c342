"""A visit linearised: where each part of its pictures by itself puts the robot."""

from typing import Self

import msgspec
import numpy as np
from msgspec import Struct

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.odometry import PARTS
from trigpoint.fusion.model.problem import Batch, Chain, Problem
from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In, Kernel, Out

from .trial import GIVEN, Trial, Work

HELD = 1e-6
"""Sigma (m, rad, s, and of scales) of what is known exactly: far below what any sighting resolves,
but not so small that next to a gap in odometry it is lost in a float's rounding."""
_REAL = np.float64
EQUATIONS = (
    *(In(_REAL, ("n", 6)), In(_REAL, ("n", 6, 6)), In(np.int64, ("n",))),
    *(In(_REAL, ("n", 6, "d")), In(_REAL, ("n", 6, "q"))),
    *(In(_REAL, ("m", "d")), In(_REAL, ("m", "d", "d")), In(_REAL, ("m", "d", "d"))),
    *(In(_REAL, ("m", "d", "q")), In(_REAL, ("q",))),
)
"""Of a visit, as the core's kernels take them first."""
LINEARISED = Kernel(
    "tp_visit_linear",
    *(*GIVEN, int, Out(np.int64, ("parts",)), Out(np.int64, ("parts",))),
    *(Out(_REAL, ("parts", 6)), Out(_REAL, ("parts", 6, 6))),
    *(Out(_REAL, ("parts", 6, "robot")), Out(_REAL, ("parts", 6, "others"))),
    *(Out(_REAL, ("steps", "robot")), Out(_REAL, ("steps", "robot", "robot"))),
    *(Out(_REAL, ("steps", "robot", "robot")), Out(_REAL, ("steps", "robot", "others"))),
)


class Linear(Struct, frozen=True):
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


class _Columns(Struct, frozen=True):
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


def linearised(trial: Trial, *, by_pictures: bool) -> Linear | None:
    """Linearise a visit about where a trial stands; None if fewer than two parts are left or the
    robot stood still.

    The parts are the pictures, without what is wrong or wild in them, or the views that are not
    wrong, each without what is wild of it by itself; those that determine no pose are left out.
    """
    pictures, problem = trial.pictures, trial.tables.assembled.problem
    (batch,) = problem.batches
    chain = problem.chains[pictures.robot]
    if chain.motion is None:
        return None
    columns = _Columns.of(problem, batch)
    d, q, steps = len(chain.tangent), len(columns.every), len(chain) - 1
    most = len(pictures.observations if by_pictures else pictures.views)
    parts, nodes = np.empty(most, dtype=np.int64), np.empty(most, dtype=np.int64)
    of_parts = [np.empty((most, 6, *shape)) for shape in ((), (6,), (d,), (q,))]
    of_steps = [np.empty((steps, d, *shape)) for shape in ((), (d,), (d,), (q,))]
    given = trial.given(Work(0))
    kept = LINEARISED(*given, by_pictures, parts, nodes, *of_parts, *of_steps)
    if kept < 2:
        return None
    shifts, own, by_robot, by_others = (each[:kept] for each in of_parts)
    moved, by_earlier, by_later, moved_by_others = of_steps
    nodes = nodes[:kept]
    by_odometry, by_slip = _step_covariances(pictures.data, chain)
    return Linear(
        shifts=shifts,
        own=own,
        nodes=nodes,
        by_robot=by_robot,
        by_others=by_others,
        parts=parts[:kept].tolist(),
        places=trial.state.robots[pictures.robot].map_from_base.translation[nodes],
        steps=moved,
        by_earlier=by_earlier,
        by_later=by_later,
        steps_by_others=moved_by_others,
        spread=chain.motion.covariance[np.ix_(range(steps), chain.tangent, chain.tangent)],
        by_odometry=by_odometry,
        by_slip=by_slip,
        broken=np.zeros((steps, d, d)),
        prior=_prior(problem, batch, columns),
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
