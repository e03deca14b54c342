"""Counts what was not used, or not in full, and remembers why."""

from collections import Counter


class LeftOut:
    """How often something was left out, by reason. `problems`: reason -> the last such problem, as
    text, where it is known; `last_problem`: the last of all, "" where there was none."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self.problems: dict[str, str] = {}
        self.last_problem = ""

    def add(self, reason: str, text: str = "", *, count: int = 1) -> None:
        """Count something; `text` says what is wrong and what to do about it."""
        self.counts[reason] += count
        if text:
            self.last_problem = self.problems[reason] = text
