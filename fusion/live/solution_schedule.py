"""When a solver solves everything to its end."""

from trigpoint.clock import to_ns

# Without anything new for this long, what came is solved.
_QUIET_NS = to_ns(2.0)
# While more comes, everything is solved again once it has grown by this factor: all these solutions
# together then take no longer than three of the last one.
_GROWTH = 1.5
_FIRST_COUNT = 20


class SolutionSchedule:
    """Everything is solved whenever much has come since the last time, and once nothing new has
    come for a while."""

    def __init__(self) -> None:
        self._came_ns = 0
        self._is_all_solved = True
        self._solved_count = 0

    def is_due(self, count: int, now_ns: int, *, is_quiet: bool, is_idle: bool) -> bool:
        """Whether the solver is to begin now; called at every turn.

        `count`: how many observations came in all; `is_quiet`: none that is new came this turn;
        `is_idle`: the solver has nothing to do.
        """
        if not is_quiet:
            self._came_ns, self._is_all_solved = now_ns, False
        if self._is_all_solved or not is_idle:
            return False
        has_grown = count > _GROWTH * self._solved_count + _FIRST_COUNT
        if not has_grown and now_ns - self._came_ns <= _QUIET_NS:
            return False
        self._is_all_solved, self._solved_count = is_quiet, count
        return True
