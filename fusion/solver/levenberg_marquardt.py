"""Solves the smoother's problem: Levenberg-Marquardt steps by elimination of the chains, in the
compiled core."""

from collections.abc import Callable

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.linalg import LinAlgError

from trigpoint.fusion.model.assembly import Assembled, assemble
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.problem import Problem, State
from trigpoint.native.library import Kernel, Out

from .equations import EXACT, Equations, EquationsHandle, Reduced
from .tables import PROBLEM, STATE, problem_tables, state_of, state_tables

_MOST_SOLVES = 21
# A rebuilt problem differs from the extrapolated one by the square of these.
_SCALE_TOLERANCE = 1e-4
_OFFSET_TOLERANCE_S = 1e-4
# The predicted decrease of χ² at which a solution has begun.
_ABOUT = 1.0
_MINIMISED = Kernel(
    "tp_minimised",
    *(EquationsHandle, *STATE, *PROBLEM),
    *(float, float, float, int, Out(np.float64, (4,))),
)


class Solution(Struct, frozen=True):
    """The state at the minimum, and the reduced information there."""

    state: State
    reduced: Reduced
    cost: float
    iterations: int
    has_converged: bool


class Minimum(Struct, frozen=True):
    """A state of least `cost`, and the normal equations there, which are those of least squares
    also where the cost is robust."""

    state: State
    equations: Equations
    cost: float
    iterations: int
    has_converged: bool


def solve(
    problem: Problem,
    start: State,
    *,
    huber: float = np.inf,
    tolerance: float = 1e-6,
    most_iterations: int = 50,
) -> Solution:
    """Find the state of least cost near `start`; raise LinAlgError where a chain is not determined.

    Corners beyond `huber` sigmas have a linear cost (Huber). Has converged when the predicted
    decrease of the cost, a χ², is less than `tolerance`.
    """
    return _solution(
        minimise(problem, start, huber=huber, tolerance=tolerance, most_iterations=most_iterations)
    )


def _solution(found: Minimum) -> Solution:
    reduced = found.equations.reduced()
    return Solution(found.state, reduced, found.cost, found.iterations, found.has_converged)


def minimise(
    problem: Problem, start: State, *, huber: float, tolerance: float, most_iterations: int
) -> Minimum:
    """`solve` without the elimination at the end; raise LinAlgError where a motion's covariance is
    not positive definite."""
    tables, handle, score = state_tables(problem, start), EquationsHandle(), np.empty(4)
    is_solved = _MINIMISED(
        *(handle, *tables, *problem_tables(problem, start)),
        *(EXACT, float(huber), float(tolerance), most_iterations, score),
    )
    if not is_solved:
        raise LinAlgError("a motion's covariance is not positive definite")
    cost, iterations, has_converged, plain_cost = score.tolist()
    state, equations = state_of(problem, start, tables), Equations(problem, plain_cost, handle)
    return Minimum(state, equations, cost, int(iterations), bool(has_converged))


def linearise(problem: Problem, state: State) -> Equations:
    """The normal equations at a state; raise LinAlgError as `minimise`."""
    return minimise(problem, state, huber=np.inf, tolerance=0.0, most_iterations=0).equations


class Solved(Struct, frozen=True):
    """The last problem, its solution and the `equations` there; `state`: all cameras and robots,
    also unused ones."""

    state: State
    assembled: Assembled
    solution: Solution
    equations: Equations
    iterations: int


def begun(problem: Problem, start: State) -> State:
    """The state of about least cost near `start` if no robot deviates from its nodes in pictures.
    With deviations steps lead to the minimum from near alone (decisions/0672)."""
    batches = tuple(replace(batch, jitter=None) for batch in problem.batches)
    steady = replace(problem, batches=batches)
    return minimise(steady, start, huber=np.inf, tolerance=_ABOUT, most_iterations=50).state


def _nothing(_: Solved) -> bool:
    return False


def solve_consistently(
    data: DataSet,
    state: State,
    *,
    tolerance: float,
    is_begun: bool = True,
    changes: Callable[[Solved], bool] = _nothing,
) -> Solved | None:
    """Solve over what is usable of the data set until the linearisation point is stable, and store
    the robots' poses in its entries; None where nothing is usable.

    Nodes are at true times, which depend on the time offsets, and odometry between them is
    integrated with its scales; a problem has both to first order only, and is reassembled where
    they have changed, or where what a solution `changes` of the data calls for it. A time offset
    that went too far, past where the robot's motion changes, goes back. Ends too where two
    solves in a row did not converge: more would take long, and hardly do. A point that never is
    stable has not converged either. `is_begun`: the state comes from a solution."""
    solved, iterations, has_converged = None, 0, True
    tried = dict[str, _Bracket]()
    for _ in range(_MOST_SOLVES):
        used = data.usable(state.cameras)
        if not used:
            return None
        solved = _solve_once(data, state, used, tolerance, is_begun=is_begun)
        iterations += solved.iterations
        had_converged, has_converged = has_converged, solved.solution.has_converged
        if not (had_converged or has_converged):
            break
        before, state, is_begun = state, solved.state, True
        has_changed = changes(solved)
        if not has_changed and _is_consistent(before, state, tried):
            break
        state, tried = _between(before, state, {} if has_changed else tried)
    else:
        assert solved is not None
        solved = replace(solved, solution=replace(solved.solution, has_converged=False))
    assert solved is not None
    return replace(solved, iterations=iterations)


def _solve_once(
    data: DataSet, state: State, used: list[int], tolerance: float, *, is_begun: bool = True
) -> Solved:
    assembled = assemble(data, state, used)
    problem, start = assembled.problem, assembled.start
    if not is_begun and any(batch.jitter is not None for batch in problem.batches):
        start = begun(problem, start)
    minimum = minimise(problem, start, huber=np.inf, tolerance=tolerance, most_iterations=50)
    found, solution = minimum.state, _solution(minimum)
    for index, node in assembled.node_of.items():
        entry = data.entries[index]
        entry.map_from_base = found.robots[entry.observation.robot].map_from_base[node]
    merged = State(state.cameras | found.cameras, state.robots | found.robots)
    return Solved(merged, assembled, solution, minimum.equations, solution.iterations)


_Bracket = tuple[tuple[float, float] | None, tuple[float, float] | None]
"""The nearest time offsets that a solve made larger, and smaller, each with how it changed."""


def _between(
    before: State, after: State, last: dict[str, _Bracket]
) -> tuple[State, dict[str, _Bracket]]:
    """A state whose time offsets lie where they would change no more, between those that changed
    either way (false position, with half the weight of an end that stays: Illinois, Dowell and
    Jarratt, 1971); and these, by camera."""
    cameras, tried = dict(after.cameras), dict[str, _Bracket]()
    for name, camera in after.cameras.items():
        offset_s = before.cameras[name].time_offset_s
        here = offset_s, camera.time_offset_s - offset_s
        low, high = last.get(name, (None, None))
        if here[1] > 0:
            low, high = here, _lighter(high) if low else high
        elif here[1] < 0:
            low, high = _lighter(low) if high else low, here
        if low and high and low[0] >= high[0]:  # all else moved: the older end is none any more
            low, high = (here, None) if here[1] > 0 else (None, here)
        if here[1] and low and high:
            share = low[1] / (low[1] - high[1])
            place_s = low[0] + share * (high[0] - low[0])
            cameras[name] = replace(camera, time_offset_s=place_s)
        tried[name] = low, high
    return replace(after, cameras=cameras), tried


def _lighter(end: tuple[float, float] | None) -> tuple[float, float] | None:
    return (end[0], 0.5 * end[1]) if end else None


def _is_consistent(before: State, after: State, tried: dict[str, _Bracket]) -> bool:
    """Whether scales and time offsets changed by little, or would be off by little."""
    for name, robot in after.robots.items():
        if np.abs(robot.scales - before.robots[name].scales).max() > _SCALE_TOLERANCE:
            return False
    return all(
        abs(camera.time_offset_s - before.cameras[name].time_offset_s) <= _OFFSET_TOLERANCE_S
        or _is_closed(*tried.get(name, (None, None)))
        for name, camera in after.cameras.items()
    )


def _is_closed(low: tuple[float, float] | None, high: tuple[float, float] | None) -> bool:
    return low is not None and high is not None and abs(high[0] - low[0]) <= _OFFSET_TOLERANCE_S
