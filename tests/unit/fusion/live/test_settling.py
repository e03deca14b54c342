"""When a live session is settled."""

import pytest
from support.fusion.small_problems import small_data
from support.fusion.solvers import Listed

from trigpoint.base.clock import to_ns
from trigpoint.fusion.live.follower import Follower
from trigpoint.fusion.live.solver_messages import Solved
from trigpoint.fusion.solver.filter import Filter


@pytest.fixture
def follower() -> Follower:
    return Follower(small_data(), Listed(), lambda: None)


def is_due(follower: Follower, now_s: float, *, is_new: bool = False) -> bool:
    return follower.is_to_settle(to_ns(now_s), is_new=is_new)


def test_what_came_last_is_settled_once_nothing_new_comes(follower: Follower) -> None:
    assert not any(is_due(follower, second, is_new=True) for second in range(100))
    assert not is_due(follower, 100.5)
    assert is_due(follower, 101.5)
    assert not is_due(follower, 160.0)


def test_a_busy_solver_is_not_asked(follower: Follower, monkeypatch: pytest.MonkeyPatch) -> None:
    is_due(follower, 1.0, is_new=True)
    follower.ask()
    assert not is_due(follower, 10.0)
    monkeypatch.setattr(Follower, "is_answered", True)
    assert is_due(follower, 11.0)


def test_nothing_is_settled_before_anything_came(follower: Follower) -> None:
    assert not is_due(follower, 60.0)


def test_what_hardly_changes_a_solution_is_settled_after_longer(follower: Follower) -> None:
    """A robot that drives past known cameras pauses behind each of them."""
    data = follower.data
    known, told = Filter.at_origin(data), data.conclusions()
    follower.solution = Solved(1000, known, {}, told, (), 0)
    is_due(follower, 1.0, is_new=True)
    assert not is_due(follower, 4.0)
    assert is_due(follower, 22.0)
    follower.add_observation(data.entries[0].observation)  # of a camera that is not located
    is_due(follower, 23.0, is_new=True)
    assert is_due(follower, 26.0)
