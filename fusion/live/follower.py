"""The live side of the smoother, where a solver process does the solving.

The filter uses every sighting at once. All input is passed on to the solver in order of time, so
much later that nothing earlier can still come that makes a correction. A solution is taken over
sighting by sighting: its filter first catches up with what has come since its last observation,
a few sightings a turn and most while no robot waits; until then the old filter makes the
corrections. So no turn takes long, and late sightings enter the new filter as well.
"""

from collections import deque
from collections.abc import Callable, Iterator

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.linalg import LinAlgError

from trigpoint.base.clock import to_ns
from trigpoint.base.errors import OperationError
from trigpoint.fusion.estimators.interface import CameraEstimate, Live, Update
from trigpoint.fusion.estimators.results import Results
from trigpoint.fusion.estimators.smoother.current_filter import CurrentFilter
from trigpoint.fusion.estimators.smoother.settled_past import LIVE
from trigpoint.fusion.model.dataset import CameraMove, DataSet, Entry, Event
from trigpoint.fusion.model.observations import Observation
from trigpoint.fusion.model.odometry import Added
from trigpoint.fusion.model.readings import Readings
from trigpoint.fusion.output import Output
from trigpoint.fusion.solver.filter import RobotEstimate

from .solver_messages import (
    Finish,
    LeaveOpen,
    Order,
    Report,
    Reported,
    Solved,
    Solver,
    TakeMove,
    TakeObservation,
    TakeOdometry,
)

# Without anything new for this long, what came is settled; what the filter could use, and is less
# than this share of what a solution keeps, only after so much longer: a robot that drives past
# cameras that are known would have all of it solved anew behind each of them.
_QUIET_NS, _LONG_QUIET_NS = to_ns(2.0), to_ns(20.0)
_LITTLE = 0.05
# An observation that comes later than this after its moment is passed on after later ones.
_MOST_HELD_S = 2.0
# How many sightings a new filter is brought on by in a turn in which none came.
_CATCHING_UP = 2


class _Recent(Struct):
    """An observation that is not part of any solution yet; `number`: its number with the solver."""

    observation: Observation
    number: int | None = None


class _Coming(Struct):
    """A solution's filter that is catching up, and the observations that it lacks, in order."""

    current: CurrentFilter
    missing: deque[Observation]


class Follower(Live):
    """See `Live`; its results come with a solver's news. Not thread-safe. `forget`: called where
    the odometry's past was dropped, for others to drop what refers to it. `solution`: the solver's
    last one, None before it; another thread may read it."""

    def __init__(self, data: DataSet, solver: Solver, forget: Callable[[], None]) -> None:
        self.data, self._solver, self._forget = data, solver, forget
        self._current = CurrentFilter(data)
        self._coming: _Coming | None = None
        self._orders: list[Order] = []
        # By robot, what came after these orders. A message by itself takes 20 µs to be packed.
        self._odometry: dict[str, list[Readings]] = {}
        self._recent: list[_Recent] = []
        self._told = 0
        self._collected: list[Observation] = []  # until they are to be solved
        self.solution: Solved | None = None
        self._asked = 0
        self._located: tuple[str, ...] = ()
        self._came, self._came_before = 0, 0
        self._reported: Reported | None = None
        self._new_ns, self._is_settled, self._is_open = 0, True, False
        self._has_new_camera = False

    # -- input ------------------------------------------------------------------------------------

    def add_odometry(self, robot: str, readings: Readings) -> list[int]:
        added = self.data.tracks[robot].add_run(readings)
        if Added.STALE in added:
            readings = readings[np.array(added) != Added.STALE]
        if len(readings):
            self._odometry.setdefault(robot, []).append(readings)
        self._current.begin(robot)
        return added

    def add_observation(self, observation: Observation) -> Update:
        try:
            correction = self._use(self._current, observation)
        except (LinAlgError, ValueError) as reason:
            return Update(problem=f"a sighting of {observation.camera} is unusable ({reason})")
        self._came += 1
        if observation.is_repeat:
            return Update(correction=correction)
        self._is_open |= correction is None
        self._recent.append(_Recent(observation))
        if self._coming is not None:
            self._coming.missing.append(observation)
        return Update(correction=correction)

    def collect(self, observation: Observation) -> None:
        self._collected.append(observation)
        self._tell(observation, is_collected=True)

    def _use(self, current: CurrentFilter, observation: Observation) -> RobotEstimate | None:
        entry = Entry(self.data.concluded(observation))
        return current.tried(entry) if observation.is_repeat else current.use(entry)

    # -- the solver -------------------------------------------------------------------------------

    def attend(self) -> Iterator[Output | Event]:
        """Take the solver's news and pass on the orders to it; yields what there is to report.

        Called at every turn.
        """
        for news in self._solver.news():
            if isinstance(news, Solved):
                self._take_over(news)
            elif isinstance(news, Reported):
                self._reported = news
            else:
                yield news
        self._catch_up()
        self._hand_over(is_all=False)

    def _take_over(self, solved: Solved) -> None:
        """Begin to take over a solution."""
        if solved.past is not None:
            self.data.forget(solved.past)
            self._forget()
        self._recent = [r for r in self._recent if r.number is None or r.number > solved.count]
        self.solution = replace(solved, known=solved.known.copy(), past=None)
        missing = sorted((r.observation for r in self._recent), key=lambda o: o.stamp_ns)
        self._coming = _Coming(self._concluded(solved), deque(missing))

    def _concluded(self, solved: Solved) -> CurrentFilter:
        """The filter that goes on from a solution, whose conclusions are taken over."""
        self.data.conclude(solved.conclusions)
        self._located = solved.located
        current = CurrentFilter(self.data)
        current.go_on_from(solved.known, told=solved.conclusions.told)
        current.shares = dict(solved.shares)
        return current

    def go_on_from(self, solved: Solved) -> bool:
        """Make corrections by the last solution of a process before this one, until the solver has
        its own over all that was collected; whether odometry reaches back to where that solution
        left each robot. Of what was collected, only sightings after all of the solution's are used:
        nothing counts twice."""
        tracks, stamps_ns = self.data.tracks, solved.known.stamps_ns
        if not all(tracks[robot].covers(stamp_ns) for robot, stamp_ns in stamps_ns.items()):
            return False
        jumps = {
            robot: tuple(step for step in steps if all(map(tracks[robot].covers, step)))
            for robot, steps in solved.conclusions.jumps.items()
        }
        solved = replace(solved, conclusions=replace(solved.conclusions, jumps=jumps))
        self._current, self._has_new_camera = self._concluded(solved), True
        for observation in sorted(self._collected, key=lambda o: o.stamp_ns):
            if observation.stamp_ns > solved.until_ns:
                self._try_using(self._current, observation)
        return True

    def _try_using(self, current: CurrentFilter, observation: Observation) -> None:
        try:
            self._use(current, observation)
        except (LinAlgError, ValueError):
            return  # the solver says what it makes of it

    def _catch_up(self) -> None:
        """Advance a new filter; it replaces the old one once it lacks nothing."""
        came, before = self._came, self._came_before
        self._came, self._came_before = 0, came
        coming = self._coming
        if not came:
            (self._current if coming is None else coming.current).settle()
        if coming is None:
            return
        for _ in range(min(len(coming.missing), catching_up(came, before))):
            self._try_using(coming.current, coming.missing.popleft())
        if not coming.missing:
            old, self._current, self._coming = self._current, coming.current, None
            self._has_new_camera |= bool(_cameras(coming.current) - _cameras(old))

    def _hand_over(self, *, is_all: bool) -> None:
        """Pass on to the solver what is old enough, in order of time."""
        ready = [r for r in self._recent if r.number is None and (is_all or self._is_old(r))]
        for recent in sorted(ready, key=lambda r: r.observation.stamp_ns):
            self._tell(recent.observation)
            recent.number = self._told
        self._order()
        orders, self._orders = self._orders, []
        if orders:
            self._solver.tell(orders)

    def _order(self, *orders: Order) -> None:
        """Give orders, behind the odometry that came before them."""
        for robot, readings in self._odometry.items():
            self._orders.append(TakeOdometry(robot, Readings.joined(readings)))
        self._odometry.clear()
        self._orders += orders

    def _is_old(self, recent: _Recent) -> bool:
        held_ns = to_ns(min(self.data.site.fusion.late, _MOST_HELD_S))
        observation = recent.observation
        return observation.stamp_ns <= self.data.tracks[observation.robot].last_ns - held_ns

    def _tell(self, observation: Observation, *, is_collected: bool = False) -> None:
        lens = self.data.lenses[observation.camera]
        self._order(TakeObservation(observation, lens, is_collected))
        self._told += 1

    def is_to_settle(self, now_ns: int, *, is_new: bool) -> bool:
        """Whether all of it is to be explained and solved now, as `calibrate` does it; called at
        every turn, with whether anything new came in it. While more comes, the solver does that by
        itself, whenever there is enough that is new to it."""
        if is_new:
            self._new_ns, self._is_settled = now_ns, False
        is_idle = not self._asked or self.is_answered
        quiet_ns = _LONG_QUIET_NS if self._is_little else _QUIET_NS
        if self._is_settled or not is_idle or now_ns - self._new_ns <= quiet_ns:
            return False
        self._is_settled, self._is_open = True, False
        return True

    @property
    def _is_little(self) -> bool:
        """Whether what came since the last solution hardly changes it: few sightings, all of which
        the filter could use."""
        known = min(self.solution.count, LIVE.sightings) if self.solution is not None else 0
        return not self._is_open and len(self._recent) < _LITTLE * known

    def camera_moved(self, move: CameraMove) -> None:
        if self.data.tell(move):
            self._is_open, self._is_settled = True, False
            self._order(TakeMove(move))

    def leave_open(self, cameras: frozenset[str]) -> None:
        self._solver.tell([LeaveOpen(cameras)])

    def finish(self) -> None:
        """Have everything solved to the end; the report comes with the solver's news."""
        self._collected.clear()
        self._ask(Finish())

    def ask(self) -> None:
        """Request a report of what is known now."""
        self._ask(Report())

    def _ask(self, order: Report | Finish) -> None:
        self._asked += 1
        self._hand_over(is_all=True)
        self._solver.tell([order])

    @property
    def is_answered(self) -> bool:
        """Whether every requested report has come."""
        reported = self._reported
        return reported is not None and reported.orders >= self._asked

    @property
    def has_results(self) -> bool:
        """Whether there are any."""
        return self._reported is not None

    @property
    def is_final(self) -> bool:
        """Whether the results are those of everything, solved to the end."""
        return self._reported is not None and self._reported.is_final

    def results(self) -> Results:
        """The network with covariance and trajectories, as last reported; raise OperationError
        where there are none yet."""
        if self._reported is None:
            raise OperationError("there is no solution yet; ask again in a moment")
        return self._reported.results

    # -- output -----------------------------------------------------------------------------------

    def robot(self, robot: str) -> RobotEstimate | None:
        return self._current.robot(robot)

    def cameras(self) -> dict[str, CameraEstimate]:
        return self._current.cameras()

    @property
    def located_count(self) -> int:
        return len(self._located)

    def take_new_camera(self) -> bool:
        """Whether a camera was located since the last call."""
        is_new, self._has_new_camera = self._has_new_camera, False
        return is_new


def catching_up(came: int, before: int) -> int:
    """By how many sightings a new filter catches up in a turn, given how many came in it and in the
    turn before.

    It gains on them whatever comes. In a turn in which a robot waits it does no more than it must:
    nothing for a single sighting after a turn without one.
    """
    if not came:
        return _CATCHING_UP
    return came + 1 if before else came - 1


def _cameras(current: CurrentFilter) -> set[str]:
    return set(current.known.layout.pose) if current.known is not None else set()
