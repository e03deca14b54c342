"""When a live session is settled."""

from trigpoint.base.clock import to_ns
from trigpoint.fusion.live.settling import SettlingSchedule


def is_due(
    schedule: SettlingSchedule, now_s: float, *, is_quiet: bool = True, is_idle: bool = True
) -> bool:
    return schedule.is_due(to_ns(now_s), is_quiet=is_quiet, is_idle=is_idle)


def test_what_came_last_is_settled_once_nothing_new_comes() -> None:
    schedule = SettlingSchedule()
    assert not any(is_due(schedule, second, is_quiet=False) for second in range(100))
    assert not is_due(schedule, 100.5)
    assert is_due(schedule, 101.5)
    assert not is_due(schedule, 160.0)


def test_a_busy_solver_is_not_asked() -> None:
    schedule = SettlingSchedule()
    is_due(schedule, 1.0, is_quiet=False)
    assert not is_due(schedule, 10.0, is_idle=False)
    assert is_due(schedule, 11.0)


def test_nothing_is_settled_before_anything_came() -> None:
    assert not is_due(SettlingSchedule(), 60.0)
