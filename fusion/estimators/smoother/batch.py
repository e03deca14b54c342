"""The batch solution: solves for everything that came in, as the association explains it.

Its input is the data set: observations and the robots' odometry. The association determines what
happened, the solver what follows from it:

- the `state` (cameras, robots, scales), its `solution` and the `problem` behind it;
- a `Filter` with what is known at the end, which `solve` returns;
- in the data set's entries: verdicts, outliers, readings, shares, and where the robot stood.
"""

import numpy as np

from trigpoint.fusion.association.events import Events
from trigpoint.fusion.association.explanation import Explanation
from trigpoint.fusion.estimators.crept import crept
from trigpoint.fusion.estimators.explained_data import explained, left_open
from trigpoint.fusion.estimators.marginals import camera_estimates
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.observations import Verdict
from trigpoint.fusion.model.problem import Problem, State
from trigpoint.fusion.solver.filter import Filter
from trigpoint.fusion.solver.innovations import innovations
from trigpoint.fusion.solver.levenberg_marquardt import Solution, Solved, solve_consistently
from trigpoint.geometry.rotation import Array

from . import odometry_noise, standstill_noise
from .second_look import take_back

_MOST_ROUNDS = 5
# Sightings taken back inform on their neighbours; what contradicts after that stays left out.
# Shares near their limit of significance would change for ever.
_MOST_LOOKS = 2
# The predicted decrease of χ² at which a solution has converged: a hundredth of a sigma.
_TOLERANCE = 1e-4


class BatchSolution:
    """The solution over a data set, redone on demand. Not thread-safe.

    `problem`, `solution`: None where nothing is located; `scales`: by robot the odometry's scale
    errors (2,) that are estimated, and their sigmas (2,).
    """

    def __init__(self, data: DataSet) -> None:
        self.data, self.state = data, data.first_state()
        self.problem: Problem | None = None
        self.solution: Solution | None = None
        self.scales: dict[str, tuple[Array, Array]] = {}
        self.iterations = 0

    def go_on_from_the_past(self) -> None:
        """Know what the data set's past says, until what is left is solved."""
        self.state, self.problem = self.data.first_state(), None

    def solve(self, explanation: Explanation) -> Filter:
        """Solve to convergence by an explanation; return the filter at its end. Where that fails,
        nothing is changed."""
        draft, state = explained(self.data, explanation)
        solved = _solved(draft, state)
        if solved is None:
            after, problem, solution = Filter.at_origin(draft), None, None
        else:
            problem, solution = solved.assembled.problem, solved.solution
            in_use = problem.layout.pose
            cameras = {name: c for name, c in solved.state.cameras.items() if name in in_use}
            state = State(cameras, solved.state.robots)
            after = Filter.after(state, problem, solution.reduced)
            self.iterations += solved.iterations
        after = after.spread(left_open(state, explanation, Events(draft.site.fusion.priors)))
        after = after.spread(crept(draft, after))
        _say_earlier(draft, after)
        self.data.take_over(draft)
        self.state, self.problem, self.solution = state, problem, solution
        self.scales = _scales(state, after) if problem is not None else {}
        return after


def _solved(data: DataSet, state: State) -> Solved | None:
    """Solve over what an explanation uses, until its noise is stable; None where nothing is
    located. Raises ValueError where that does not converge."""
    events, looks, rounds = Events(data.site.fusion.priors), 0, 0

    def changes(solved: Solved) -> bool:
        nonlocal looks, rounds
        if rounds == _MOST_ROUNDS:
            return False
        changed = leave_out_contradicting(data, solved, events)
        # By a solution that followed a wrong sighting it would fit again.
        if not changed and looks < _MOST_LOOKS:
            looks += 1
            changed |= take_back(data, solved.assembled, solved.state, events)
            changed |= standstill_noise.share_out(data, solved.assembled, solved.state)
        changed |= odometry_noise.learn(data, solved.assembled, solved.state)
        rounds += changed
        return changed

    solved = solve_consistently(data, state, tolerance=_TOLERANCE, is_begun=False, changes=changes)
    if solved is not None and not solved.solution.has_converged:
        raise ValueError(f"the solution did not converge in {solved.iterations} iterations")
    return solved


def _scales(state: State, after: Filter) -> dict[str, tuple[Array, Array]]:
    columns = after.layout.scales
    return {
        robot: (
            state.robots[robot].scales,
            np.sqrt(np.diagonal(after.known.covariance_of(columns[robot]))),
        )
        for robot in columns
    }


def _say_earlier(data: DataSet, known: Filter) -> None:
    """Set the poses that cameras had before they were moved."""
    estimates = camera_estimates(known, [move.name for move in data.moves])
    for move in data.moves:
        if move.name in estimates:
            move.map_from_camera = estimates[move.name].map_from_camera
            move.covariance = estimates[move.name].covariance


def leave_out_contradicting(data: DataSet, solved: Solved, events: Events) -> bool:
    """Leave out the worst of each robot's sightings that contradict the solution; whether any was.

    The association judges a visit's sightings by that visit, most to first order. In the solution
    everything takes part: a sighting is wrong that is less probable, where all else predicts it,
    than one whose board may be anywhere. A wrong one that pulls good ones away is at least twice as
    bad as they are, so those that are less than half as bad as the worst are judged again later.
    """
    problem, found = solved.assembled.problem, list[tuple[str, int, int]]()
    sightings, first = list[tuple[int, int, int]](), 0
    for batch in problem.batches:
        for row, source in enumerate(batch.sources.tolist()):
            for order, part in enumerate(data.entries[source].observation.parts):
                if np.any(batch.weights[row, part]):  # it is not left out already
                    sightings.append((first + row, part.start, part.stop - part.start))
                    found.append((batch.robot, source, order))
        first += len(batch.sources)
    asked = np.array(sightings, dtype=np.int64).reshape(-1, 3)
    state, room = solved.state, events.room_variances
    chi2, spread = innovations(solved.equations, state, asked, room_variances=room)
    excess = events.over_anywhere(chi2, spread).tolist()
    worst = dict.fromkeys(problem.chains, 0.0)
    left_out = set[int]()
    for over, (robot, source, order) in sorted(zip(excess, found, strict=True), reverse=True):
        worst[robot] = max(worst[robot], over)
        # Of two that contradict each other in one picture, the other may be right.
        if over > worst[robot] / 2 and source not in left_out:
            left_out.add(source)
            entry = data.entries[source]
            wild = list(entry.observation.wild)
            wild[order] = np.ones_like(wild[order])
            entry.observation = entry.observation.with_outliers(tuple(wild))
            if not entry.observation.used_views:
                entry.observation = entry.observation.judged(Verdict.REJECTED)
    return bool(left_out)
