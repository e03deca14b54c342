"""Solves repeatedly until the linearisation point, odometry scales and time offsets, is stable.

Nodes are at true times, which depend on the time offsets, and odometry between them is integrated
with its scales; a problem has both to first order only, and is reassembled where they have changed.
"""

import numpy as np
from msgspec import Struct

from trigpoint.fusion.model.assembly import Assembled, assemble
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.problem import State

from .levenberg_marquardt import Solution, solve

_MOST_REBUILDS = 20
# A rebuilt problem differs from the extrapolated one by the square of these.
_SCALE_TOLERANCE = 1e-4
_OFFSET_TOLERANCE_S = 1e-4


class Solved(Struct, frozen=True):
    """The last problem and its solution; `state`: all cameras and robots, also unused ones."""

    state: State
    assembled: Assembled
    solution: Solution
    iterations: int


def solve_consistently(data: DataSet, state: State, used: list[int], *, tolerance: float) -> Solved:
    """Solve over these entries of the data set, and store the robots' poses in them. Ends too where
    two solves in a row did not converge: more would take long, and hardly do."""
    solved = _solve_once(data, state, used, tolerance)
    iterations = solved.iterations
    for _ in range(_MOST_REBUILDS):
        if _is_consistent(state, solved.state):
            break
        had_converged, state = solved.solution.has_converged, solved.state
        solved = _solve_once(data, state, used, tolerance)
        iterations += solved.iterations
        if not (had_converged or solved.solution.has_converged):
            break
    return Solved(solved.state, solved.assembled, solved.solution, iterations)


def _solve_once(data: DataSet, state: State, used: list[int], tolerance: float) -> Solved:
    assembled = assemble(data, state, used)
    solution = solve(assembled.problem, assembled.start, tolerance=tolerance)
    found = solution.state
    for index, node in assembled.node_of.items():
        entry = data.entries[index]
        entry.map_from_base = found.robots[entry.observation.robot].map_from_base[node]
    merged = State(state.cameras | found.cameras, state.robots | found.robots)
    return Solved(merged, assembled, solution, solution.iterations)


def _is_consistent(before: State, after: State) -> bool:
    for name, robot in after.robots.items():
        if np.abs(robot.scales - before.robots[name].scales).max() > _SCALE_TOLERANCE:
            return False
    return all(
        abs(camera.time_offset_s - before.cameras[name].time_offset_s) <= _OFFSET_TOLERANCE_S
        for name, camera in after.cameras.items()
    )
