"""When a problem is assembled anew, and when that ends."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from trigpoint.fusion.model.problem import CameraState, RobotState, State
from trigpoint.fusion.solver import levenberg_marquardt
from trigpoint.fusion.solver.levenberg_marquardt import Solution, Solved, solve_consistently
from trigpoint.geometry import CameraModel, Pose


@pytest.mark.parametrize(("has_converged", "solves"), [(False, 2), (True, 21)])
def test_two_solves_in_a_row_that_do_not_converge_end_it(
    has_converged: bool, solves: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = list[Any]()

    def solved(*_: Any, **_begun: bool) -> Any:
        state, none = _with_scales(float(len(found))), cast(Any, None)
        solution = Solution(state, none, 0.0, 1, has_converged)
        found.append(Solved(state, none, solution, none, 1))
        return found[-1]

    monkeypatch.setattr(levenberg_marquardt, "_solve_once", solved)
    data = SimpleNamespace(usable=lambda _: [0])
    last = solve_consistently(cast(Any, data), _with_scales(-1.0), tolerance=1.0)
    assert last is not None
    assert len(found) == solves
    assert not last.solution.has_converged


@pytest.mark.parametrize("slopes", [(1, 3), (3, 3), (10, 1.2), (1.9, 8), (30, 30)])
def test_time_offset_that_each_solve_takes_too_far_is_found(
    slopes: tuple[float, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert _settled(lambda x: x + slopes[x >= 0.05] * (0.05 - x), monkeypatch) == pytest.approx(
        0.05, abs=2e-4
    )


def test_time_offset_at_a_step_of_its_own_is_there(monkeypatch: pytest.MonkeyPatch) -> None:
    assert _settled(lambda x: x + (0.01 if x < 0.0333 else -0.01), monkeypatch) == pytest.approx(
        0.0333, abs=0.011
    )


def _settled(after: Callable[[float], float], monkeypatch: pytest.MonkeyPatch) -> float:
    """The time offset that comes out where each solve makes this of one, seconds."""
    lens = CameraModel(640, 480, 500.0, 500.0, 320.0, 240.0)

    def at(offset_s: float) -> State:
        return State({"c1": CameraState(Pose.identity(), lens, offset_s)}, {})

    def solved(_data: Any, state: State, *_: Any, **_begun: bool) -> Solved:
        found, none = at(after(state.cameras["c1"].time_offset_s)), cast(Any, None)
        return Solved(found, none, Solution(found, none, 0.0, 1, True), none, 1)

    monkeypatch.setattr(levenberg_marquardt, "_solve_once", solved)
    data = SimpleNamespace(usable=lambda _: [0])
    last = solve_consistently(cast(Any, data), at(0.0), tolerance=1.0)
    assert last is not None
    assert last.solution.has_converged
    return last.state.cameras["c1"].time_offset_s


def _with_scales(scale: float) -> State:
    nothing = Pose.stack([])
    return State({}, {"r1": RobotState(nothing, np.full(2, scale), nothing)})
