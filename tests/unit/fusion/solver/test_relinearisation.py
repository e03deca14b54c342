"""Rebuilding a problem ends where it does not lead to a solution."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from trigpoint.fusion.solver import levenberg_marquardt
from trigpoint.fusion.solver.levenberg_marquardt import Solved, solve_consistently


@pytest.mark.parametrize(("has_converged", "solves"), [(False, 2), (True, 21)])
def test_two_solves_in_a_row_that_do_not_converge_end_it(
    has_converged: bool, solves: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = list[Any]()

    def solved(*_: Any) -> Any:
        robot = SimpleNamespace(scales=np.full(2, float(len(found))))
        state = SimpleNamespace(cameras={}, robots={"r1": robot})
        found.append(Solved(cast(Any, state), cast(Any, None), _solution(has_converged), 1))
        return found[-1]

    monkeypatch.setattr(levenberg_marquardt, "_solve_once", solved)
    start = SimpleNamespace(cameras={}, robots={"r1": SimpleNamespace(scales=np.full(2, -1.0))})
    solve_consistently(cast(Any, None), cast(Any, start), [], tolerance=1.0)
    assert len(found) == solves


def _solution(has_converged: bool) -> Any:
    return SimpleNamespace(has_converged=has_converged)
