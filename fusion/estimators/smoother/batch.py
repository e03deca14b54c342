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
from trigpoint.fusion.model.problem import Problem, State
from trigpoint.fusion.solver.filter import Filter
from trigpoint.fusion.solver.levenberg_marquardt import Solution
from trigpoint.fusion.solver.relinearisation import Solved, solve_consistently
from trigpoint.geometry.rotation import Array

from . import odometry_noise, standstill_noise
from .contradicting_sightings import leave_out_contradicting
from .second_look import take_back

_MOST_ROUNDS = 6
# Sightings taken back inform on their neighbours; what contradicts after that stays left out.
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
        state, solved, iterations = _solved(draft, state)
        if solved is None:
            after, problem, solution = Filter.at_origin(draft), None, None
        else:
            problem, solution = solved.assembled.problem, solved.solution
            after = Filter.after(state, problem, solution.reduced)
        after = after.spread(left_open(state, explanation, Events(draft.site.fusion.priors)))
        after = after.spread(crept(draft, after))
        _say_earlier(draft, after)
        self.data.take_over(draft)
        self.state, self.problem, self.solution = state, problem, solution
        self.scales = _scales(state, after) if problem is not None else {}
        self.iterations += iterations
        return after


def _solved(data: DataSet, state: State) -> tuple[State, Solved | None, int]:
    """Solve over what an explanation uses, until its noise is stable: the state, the last solution
    (None where nothing is located), and the iterations that all took; raise ValueError where that
    does not converge, at the latest after two rounds in a row that did not."""
    events, solved, iterations = Events(data.site.fusion.priors), None, 0
    has_converged = True
    for round_ in range(_MOST_ROUNDS):
        used = data.usable(state.cameras)
        if not used:
            return state, None, iterations
        solved = solve_consistently(data, state, used, tolerance=_TOLERANCE)
        state, iterations = solved.state, iterations + solved.iterations
        had_converged, has_converged = has_converged, solved.solution.has_converged
        if not (had_converged or has_converged):
            break
        changed = leave_out_contradicting(data, solved.assembled, state, events)
        if round_ < _MOST_LOOKS:
            changed |= take_back(data, solved.assembled, state, events)
        changed |= standstill_noise.share_out(data, solved.assembled, state)
        changed |= odometry_noise.learn(data, solved.assembled, state)
        if not changed:
            break
    assert solved is not None
    if not has_converged:
        raise ValueError(f"the solution did not converge in {iterations} iterations")
    in_use = solved.assembled.problem.layout.pose
    cameras = {name: camera for name, camera in state.cameras.items() if name in in_use}
    return State(cameras, state.robots), solved, iterations


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
