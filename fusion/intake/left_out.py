"""Counts what was not used, or not in full, and remembers why."""

from collections import Counter

from msgspec import Struct


class Problem(Struct, frozen=True):
    """What is wrong and what to do about it, and how often it was so."""

    text: str
    count: int


class LeftOut:
    """How often something was left out, by reason. `problems`: reason, and of whom -> the last such
    problem, where it is known; `last_problem`: the last of all, "" where there was none."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self.problems: dict[str, Problem] = {}
        self.last_problem = ""

    def add(self, reason: str, text: str = "", *, of: str = "", count: int = 1) -> None:
        """Count something; `text` says what is wrong with the camera or robot `of`, and what to do
        about it."""
        self.counts[reason] += count
        if text:
            name = f"{reason} {of}".rstrip()
            known = self.problems.get(name)
            self.problems[name] = Problem(text, (known.count if known else 0) + count)
            self.last_problem = text
