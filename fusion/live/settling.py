"""When a live session is settled: everything decided and solved to its end, as `calibrate` does it.

What comes in between is solved by the solver itself, whenever a tenth more has come.
"""

from trigpoint.clock import to_ns

# Without anything new for this long, what came is settled.
_QUIET_NS = to_ns(2.0)
# While more comes, everything is settled again once it has grown by this factor: all times together
# then take no longer than three of the last one.
_GROWTH = 1.5
_FIRST_COUNT = 20


class SettlingSchedule:
    """The session is settled whenever much has come since the last time, and once nothing new has
    come for a while."""

    def __init__(self) -> None:
        self._came_ns = 0
        self._is_all_settled = True
        self._settled_count = 0

    def is_due(self, count: int, now_ns: int, *, is_quiet: bool, is_idle: bool) -> bool:
        """Whether the solver is to begin now; called at every turn.

        `count`: how many observations came in all; `is_quiet`: none that is new came this turn;
        `is_idle`: the solver has nothing to do.
        """
        if not is_quiet:
            self._came_ns, self._is_all_settled = now_ns, False
        if self._is_all_settled or not is_idle:
            return False
        has_grown = count > _GROWTH * self._settled_count + _FIRST_COUNT
        if not has_grown and now_ns - self._came_ns <= _QUIET_NS:
            return False
        self._is_all_settled, self._settled_count = is_quiet, count
        return True
