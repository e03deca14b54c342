"""When a solver solves everything to its end."""

from itertools import pairwise

from trigpoint.clock import to_ns
from trigpoint.fusion.live.solution_schedule import SolutionSchedule


def turns(schedule: SolutionSchedule, counts: list[int], *, is_idle: bool = True) -> list[int]:
    """The counts at which a solution is due, one turn a second, each with something new."""
    return [
        count
        for second, count in enumerate(counts)
        if schedule.is_due(count, to_ns(second), is_quiet=False, is_idle=is_idle)
    ]


def is_due_later(schedule: SolutionSchedule, count: int, now_s: float) -> bool:
    return schedule.is_due(count, to_ns(now_s), is_quiet=True, is_idle=True)


def test_while_more_comes_solutions_are_ever_farther_apart() -> None:
    found = turns(SolutionSchedule(), list(range(1000)))
    assert found[0] == 21
    assert len(found) < 10
    assert all(later > 1.5 * earlier for earlier, later in pairwise(found))


def test_what_came_last_is_solved_once_nothing_new_comes() -> None:
    schedule = SolutionSchedule()
    turns(schedule, [1, 2, 3])
    assert not is_due_later(schedule, 3, 3.5)
    assert is_due_later(schedule, 3, 4.5)
    assert not is_due_later(schedule, 3, 60.0)


def test_a_busy_solver_is_not_asked() -> None:
    assert turns(SolutionSchedule(), [100, 1000], is_idle=False) == []


def test_nothing_is_solved_before_anything_came() -> None:
    assert not is_due_later(SolutionSchedule(), 0, 60.0)
