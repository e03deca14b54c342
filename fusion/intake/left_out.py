"""Counts what was not used, or not in full, and what happened; and remembers why."""

from collections import Counter, deque

from msgspec import Struct

from trigpoint.fusion.model.dataset import DataSet, Event

_MOST_EVENTS = 100


class Problem(Struct, frozen=True):
    """What is wrong and what to do about it, and how often it was so."""

    text: str
    count: int


class LeftOut:
    """How often something was left out, by reason, or happened, by kind. `problems`: reason, and of
    whom -> the last such problem, where it is known; `last_problem`: the last of all, "" where
    there was none; `events`: the last ones."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self.problems: dict[str, Problem] = {}
        self.last_problem = ""
        self.events = deque[Event](maxlen=_MOST_EVENTS)

    def add(self, reason: str, text: str = "", *, of: str = "", count: int = 1) -> None:
        """Count something; `text` says what is wrong with the camera or robot `of`, and what to do
        about it."""
        self.counts[reason] += count
        if text:
            name = f"{reason} {of}".rstrip()
            known = self.problems.get(name)
            self.problems[name] = Problem(text, (known.count if known else 0) + count)
            self.last_problem = text

    def happened(self, event: Event) -> None:
        """Count and keep an event."""
        self.counts[event.kind] += 1
        self.last_problem = event.text
        self.events.append(event)

    def take_from(self, data: DataSet) -> None:
        """Add the changes of the site that the estimator has found since."""
        events, data.events = data.events, []
        for event in events:
            self.happened(event)
