"""When a live session is settled."""

from itertools import pairwise

from trigpoint.clock import to_ns
from trigpoint.fusion.live.settling import SettlingSchedule


def turns(schedule: SettlingSchedule, counts: list[int], *, is_idle: bool = True) -> list[int]:
    """The counts at which the session is settled, one turn a second, each with something new."""
    return [
        count
        for second, count in enumerate(counts)
        if schedule.is_due(count, to_ns(second), is_quiet=False, is_idle=is_idle)
    ]


def is_due_later(schedule: SettlingSchedule, count: int, now_s: float) -> bool:
    return schedule.is_due(count, to_ns(now_s), is_quiet=True, is_idle=True)


def test_while_more_comes_it_is_settled_ever_more_rarely() -> None:
    found = turns(SettlingSchedule(), list(range(1000)))
    assert found[0] == 21
    assert len(found) < 10
    assert all(later > 1.5 * earlier for earlier, later in pairwise(found))


def test_what_came_last_is_settled_once_nothing_new_comes() -> None:
    schedule = SettlingSchedule()
    turns(schedule, [1, 2, 3])
    assert not is_due_later(schedule, 3, 3.5)
    assert is_due_later(schedule, 3, 4.5)
    assert not is_due_later(schedule, 3, 60.0)


def test_a_busy_solver_is_not_asked() -> None:
    assert turns(SettlingSchedule(), [100, 1000], is_idle=False) == []


def test_nothing_is_settled_before_anything_came() -> None:
    assert not is_due_later(SettlingSchedule(), 0, 60.0)
