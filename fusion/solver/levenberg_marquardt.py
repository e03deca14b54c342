"""Solves the smoother's problem: Levenberg-Marquardt steps by elimination of the chains, in the
compiled core."""

import numpy as np
from msgspec import Struct
from numpy.linalg import LinAlgError

from trigpoint.fusion.model.problem import Problem, State
from trigpoint.native.library import Kernel, Out

from .equations import EXACT, Equations, EquationsHandle, Reduced
from .tables import PROBLEM, STATE, problem_tables, state_of, state_tables

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
    found = minimise(
        problem, start, huber=huber, tolerance=tolerance, most_iterations=most_iterations
    )
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
