"""What happened at a site, as it is told."""

from collections import deque

from trigpoint.fusion.model.dataset import DataSet, Event

from .left_out import LeftOut

_MOST = 100


class EventLog:
    """The last events, each counted by its kind in `left_out`."""

    def __init__(self, left_out: LeftOut) -> None:
        self._left_out = left_out
        self._events = deque[Event](maxlen=_MOST)

    def add(self, event: Event) -> None:
        """Count and keep an event."""
        self._left_out.add(event.kind)
        self._left_out.last_problem = event.text
        self._events.append(event)

    def take_from(self, data: DataSet) -> None:
        """Add the changes of the site that the estimator has found since."""
        events, data.events = data.events, []
        for event in events:
            self.add(event)

    @property
    def texts(self) -> list[str]:
        """What happened, in words."""
        return [event.text for event in self._events]

    @property
    def kinds(self) -> set[str]:
        """The kinds of what happened."""
        return {event.kind for event in self._events}
