"""When a live session is settled: all of it explained and solved, as `calibrate` does it.

While more comes, the solver does that by itself, whenever there is enough that is new to it.
"""

from trigpoint.base.clock import to_ns

# Without anything new for this long, what came is settled.
_QUIET_NS = to_ns(2.0)


class SettlingSchedule:
    """The session is settled once nothing new has come for a while."""

    def __init__(self) -> None:
        self._came_ns = 0
        self._is_settled = True

    def is_due(self, now_ns: int, *, is_quiet: bool, is_idle: bool) -> bool:
        """Whether the solver is to begin now; called at every turn.

        `is_quiet`: nothing that is new came this turn; `is_idle`: the solver has nothing to do.
        """
        if not is_quiet:
            self._came_ns, self._is_settled = now_ns, False
        if self._is_settled or not is_idle or now_ns - self._came_ns <= _QUIET_NS:
            return False
        self._is_settled = True
        return True
