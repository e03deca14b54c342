"""Hands what changes to every open page; a page that does not read is dropped, never awaited."""

from collections.abc import Mapping

from trigpoint.tools.web.pages import Page, Pages, event

from .entities import Change, Entities, Fields, Whole, apply, difference

MOST_PAGES = 24
MOST_WAITING = 100
"""Changes that may wait for one page: five seconds' worth."""
QUIET_S = 1.0
"""Something is sent at least this often, so that a page knows a silent server from a still site."""


class Feed(Pages):
    """What is shown now, and the pages that it is shown on. Any thread."""

    def __init__(self) -> None:
        super().__init__(most=MOST_PAGES, waiting=MOST_WAITING)
        self._shown: Entities = {}
        self._said_s = self.now_s = 0.0

    def update(self, now: Mapping[str, Fields | None], t: float) -> Change:
        """Take these entities' state now, and send what is different; returns it."""
        with self._lock:
            change = difference(self._shown, now, round(t, 2))
            apply(self._shown, change)
            self.now_s = t
            if change.is_empty and t - self._said_s < QUIET_S:
                return change
            self._said_s = t
            self.offer(event(change))
        return change

    def join(self, ways: dict[str, list[float]]) -> Page:
        """A further page, which begins with the whole state and the robots' `ways` up to now.
        Called in the server's loop."""
        with self._lock:
            return self.open(event(Whole(round(self.now_s, 2), dict(self._shown), ways)))

    def whole(self) -> Entities:
        with self._lock:
            return dict(self._shown)
