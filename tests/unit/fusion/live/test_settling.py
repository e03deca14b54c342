"""When a live session is settled."""

import pytest
from support.fusion.small_problems import small_data
from support.fusion.solvers import Listed

from trigpoint.base.clock import to_ns
from trigpoint.fusion.live.follower import Follower


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
