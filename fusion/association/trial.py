"""A visit on the way to one of its modes: how each of its sightings is read, which are wrong, and
the problem that these make, all of which the core changes round by round (`visit.cpp`)."""

from enum import IntEnum, IntFlag

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.fusion.model.assembly import Assembled, assemble
from trigpoint.fusion.model.dataset import DataSet, Entry
from trigpoint.fusion.model.observations import Observation, Verdict, View, moving
from trigpoint.fusion.model.problem import CameraState, RobotState, State
from trigpoint.fusion.reading.views import BODY, VIEWS, body_tables, view_tables
from trigpoint.fusion.solver.equations import EXACT, Equations, EquationsHandle
from trigpoint.fusion.solver.tables import PROBLEM, STATE, problem_tables, state_of, state_tables
from trigpoint.geometry import Pose
from trigpoint.native.library import In, Kernel, Out

from .events import Events

# The iteration ends at a step that promises to lower χ² by less than this, which is far below what
# any decision depends on.
_TOLERANCE = 0.03
_MOST_STEPS = 12
# Of how many clocks a visit's tables are kept. They have a clock to first order: where it differs
# by less, they are off by half of an acceleration times the square of this, some micrometres.
_MOST_KEPT = 8
_CLOCK_S = 5e-3
# A clock that is off by months, or has a drift beyond all measure.
_DIVERGED = 1e7
# Of `PROBLEM`: the robot's deviations in pictures; what a round writes, the corners' faces, points
# and weights.
_DEVIATIONS, _WRITTEN = 10, (11, 12, 14)
_REAL, _WHOLE, _FLAG = np.float64, np.int64, np.bool_
GIVEN = (
    *(EquationsHandle, *STATE),
    *(Out(p.dtype, p.shape) if i in _WRITTEN and isinstance(p, In) else p
      for i, p in enumerate(PROBLEM)),
    *(float, float, float, int, Out(_REAL, (4,))),
    *(*BODY, *VIEWS, In(_WHOLE, ("views",)), In(_WHOLE, ("views",))),
    *(Out(_WHOLE, ("views",)), Out(_FLAG, ("views",)), Out(_FLAG, ("views",))),
    *(Out(_FLAG, ("corners",)), In(_REAL, (6,)), In(_REAL, (4,)), int),
)  # fmt: skip
"""What the core is given of a trial: `Given` and `Rest` of `visit.cpp`."""
_ROUND = Kernel("tp_visit_round", *GIVEN)


class Work(IntFlag):
    """What a round does: reads each view as it fits best where camera and robot are; solves;
    judges what is wrong, about a minimum of the robust cost where it is `ROBUST`."""

    READ = 1
    SOLVE = 2
    JUDGE = 4
    ROBUST = 8


class Ending(IntEnum):
    """How a round ends: nothing fits, or all is judged as before it, or otherwise."""

    NOTHING_FITS = 0
    JUDGED_SAME = 1
    JUDGED_OTHERWISE = 2


class Tables(Struct, frozen=True):
    """A visit's problem with one `clock`, its offset and drift: `node_of` (p,): each picture's
    node; `problem` and `views`: as the core takes them; `rows` (v,): where each view's corners
    begin in the problem's; `early_s`: how long before a picture's stamp its node lies, by the
    clock at the first picture."""

    clock: tuple[float, float]
    assembled: Assembled
    node_of: np.ndarray
    problem: tuple[np.ndarray | int, ...]
    views: tuple[np.ndarray, ...]
    rows: np.ndarray
    early_s: float


class Pictures:
    """A visit's pictures (p) of one robot by one camera, in order, and the views (v) in them.

    `picture_of` (v,): which one a view is in; `ends`: where each one's views end; `view_of` (k,):
    which view each of their corners is of.
    """

    def __init__(self, data: DataSet, observations: list[Observation], events: Events) -> None:
        self.data, self.observations = data, observations
        self.camera, self.robot = observations[0].camera, observations[0].robot
        self.target, self.robots = data.targets[self.robot], data.first_state().robots
        counts = [len(observation.views) for observation in observations]
        self.picture_of = np.repeat(np.arange(len(counts)), counts)
        self.ends = np.cumsum(counts).tolist()
        self.views = [view for observation in observations for view in observation.views]
        widths = np.array([len(view.corners) for view in self.views])
        self._corner_ends = np.cumsum(widths).tolist()
        self.view_of = np.repeat(np.arange(len(widths)), widths)
        self.jitter = data.jitter.get(self.robot)
        self.limits = np.array(
            [events.wild_score, events.wrong_limit, events.pose_score, events.sighting_gate]
        )
        self.room = events.room_variances
        ends_ns = np.array([observations[0].stamp_ns, observations[-1].stamp_ns])
        since_epoch_s = data.since_epoch_s(ends_ns)
        self._first_s, self._furthest_s = since_epoch_s[:1], float(np.abs(since_epoch_s).max())
        self._tables: list[Tables] = []

    def split(self, flags: np.ndarray) -> list[np.ndarray]:
        """What is said of all corners, by view."""
        bounds = zip([0, *self._corner_ends], self._corner_ends, strict=False)
        return [flags[start:end] for start, end in bounds]

    def tables(self, camera: CameraState, poses: Pose) -> Tables:
        """The problem with about a camera's clock; `poses` (p): where the robot may be."""
        near = [row for row, kept in enumerate(self._tables) if self.does_for(kept, camera.clock)]
        found = self._tables.pop(near[-1]) if near else self._assembled(camera, poses)
        self._tables.append(found)  # the last one used is the last
        del self._tables[:-_MOST_KEPT]
        return found

    def does_for(self, tables: Tables, clock: tuple[float, float]) -> bool:
        """Whether a clock is so near that of a problem that it need not be assembled anew."""
        offset, drift = (abs(one - other) for one, other in zip(clock, tables.clock, strict=True))
        return offset + drift * self._furthest_s <= _CLOCK_S

    def _assembled(self, camera: CameraState, poses: Pose) -> Tables:
        entries = []
        for row, observation in enumerate(self.observations):
            some = observation.read_as(tuple(view.readings[0] for view in observation.views))
            entries.append(Entry(some.judged(Verdict.ACCEPTED), poses[row]))
        small, state = (
            replace(self.data, entries=entries),
            State({self.camera: camera}, self.robots),
        )
        assembled = assemble(small, state, list(range(len(entries))), anchored=False)
        node_of = np.array([assembled.node_of[row] for row in range(len(entries))])
        (batch,) = assembled.problem.batches
        widths = np.array([len(view.corners) for view in self.views])
        before = np.cumsum(widths) - widths
        first = before[np.searchsorted(self.picture_of, np.arange(len(entries)))]
        rows = batch.weights.shape[1] * self.picture_of + before - first[self.picture_of]
        return Tables(
            camera.clock,
            assembled,
            node_of,
            problem_tables(assembled.problem, assembled.start),
            view_tables(self._moving(camera)),
            rows,
            camera.offset_s(self._first_s).item(),
        )

    def _moving(self, camera: CameraState) -> list[View]:
        """The views of a robot that moves as odometry says when each is taken."""
        stamps_ns = np.array([observation.stamp_ns for observation in self.observations])
        times_ns = self.data.true_times_ns(camera, stamps_ns)
        track, scales = self.data.tracks[self.robot], self.robots[self.robot].scales
        moved = moving(self.observations, track, times_ns, scales)
        return [view for observation in moved for view in observation.views]


class Trial:
    """The current interpretation of a visit's pictures. `poses` (p): where the robot stood in each;
    `chosen` (v,): the number of each view's reading; `wrong`, `hidden` (v,): which are wrong, and
    which no reading can show; `wild` (k,): which of all their corners are."""

    def __init__(
        self, pictures: Pictures, camera: CameraState, poses: Pose, wrong: np.ndarray
    ) -> None:
        self.pictures, self.poses, self.wrong = pictures, poses, wrong
        self.chosen = np.zeros(len(wrong), _WHOLE)
        self.hidden = np.zeros(len(wrong), _FLAG)
        self.wild = np.zeros(len(pictures.view_of), _FLAG)
        self._handle, self._score = EquationsHandle(), np.zeros(4)
        self._begin(camera)

    def _begin(self, camera: CameraState, robot: RobotState | None = None) -> None:
        """Take the problem with a camera's clock, and begin with that camera."""
        mine = self.pictures.robot
        self.tables = self.pictures.tables(camera, self.poses)
        problem = self.tables.assembled.problem
        nodes = np.zeros((len(problem.chains[mine]), 12))
        nodes[:, :9:4] = 1.0
        nodes[self.tables.node_of] = self.poses.rows()
        robot = replace(robot or self.pictures.robots[mine], map_from_base=Pose.from_rows(nodes))
        self._start = State({self.pictures.camera: camera}, {mine: robot})
        self._state = state_tables(problem, self._start)

    @property
    def state(self) -> State:
        """Where the last round ended."""
        return state_of(self.tables.assembled.problem, self._start, self._state)

    @property
    def camera(self) -> CameraState:
        return self.state.cameras[self.pictures.camera]

    @property
    def equations(self) -> Equations:
        """The normal equations at the state, once it was solved for."""
        return Equations(self.tables.assembled.problem, float(self._score[3]), self._handle)

    @property
    def iterations(self) -> int:
        """How many steps the last round took."""
        return int(self._score[1])

    @property
    def signature(self) -> tuple[bytes, ...]:
        """All that its solution depends on, except where the solver starts."""
        return self.chosen.tobytes(), self.wrong.tobytes(), self.wild.tobytes()

    def round(self, work: Work, *, huber: float = np.inf) -> Ending:
        """Go on by one round; corners beyond `huber` sigmas have a linear cost (Huber)."""
        pictures, (offset, drift) = self.pictures, self._state[2][0].tolist()
        if not (abs(offset) < _DIVERGED and abs(drift) < _DIVERGED):
            return Ending.NOTHING_FITS
        if not pictures.does_for(self.tables, (offset, drift)):
            self._begin(self.camera, self.state.robots[pictures.robot])
        tables = self.tables
        if pictures.jitter is not None and pictures.jitter.length > 0:
            deviations = tables.problem[_DEVIATIONS]
            assert isinstance(deviations, np.ndarray)
            deviations[:, :6] = pictures.jitter.among(self.poses.translation)
        self._score[:] = 0.0
        ending = _ROUND(*self.given(work, huber))
        self.poses = Pose.from_rows(self._state[3][tables.node_of])
        return Ending(ending)

    def given(self, work: Work, huber: float = np.inf) -> tuple[object, ...]:
        """What the core is given: `GIVEN`."""
        pictures, tables = self.pictures, self.tables
        return (
            *(self._handle, *self._state, *tables.problem),
            *(EXACT, float(huber), _TOLERANCE, _MOST_STEPS, self._score),
            *(*body_tables(pictures.target), *tables.views, pictures.picture_of, tables.rows),
            *(self.chosen, self.wrong, self.hidden, self.wild),
            *(pictures.room, pictures.limits, int(work)),
        )
