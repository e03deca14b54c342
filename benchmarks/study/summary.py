"""What many sessions of one situation say together, and how a page shows it."""

from collections.abc import Iterable, Sequence

import numpy as np
from msgspec import Struct

from .measure import Measure


class Ratio(Struct, frozen=True):
    """The root of the mean of normalised squares, and its standard error; NaN of nothing."""

    value: float
    error: float

    def told(self, digits: int) -> str:
        """For people."""
        if np.isnan(self.value):
            return "–"
        error = "" if np.isnan(self.error) else f" ± {self.error:.{digits}f}"
        return f"{self.value:.{digits}f}{error}"


def ratio_of(found: Iterable[float | None]) -> Ratio:
    """Of the squares of all sessions that have one."""
    squares = [square for square in found if square is not None]
    if not squares:
        return Ratio(np.nan, np.nan)
    value = float(np.sqrt(np.mean(squares)))
    if len(squares) < 2:
        return Ratio(value, np.nan)
    error = float(np.std(squares, ddof=1) / np.sqrt(len(squares)) / (2 * value))
    return Ratio(value, error)


def mean_of(measures: list[Measure], name: str) -> float:
    """Of one of their numbers."""
    return float(np.mean([getattr(measure, name) for measure in measures]))


def count_of(measures: Iterable[Measure], *names: str) -> int:
    """How many sessions have a camera in one of these lists."""
    return sum(any(getattr(measure, name) for name in names) for measure in measures)


def page_table(head: str, rows: Iterable[Sequence[str]]) -> list[str]:
    """Lines of Markdown; `head` with its bars."""
    rule = " | ".join(["---"] * (head.count("|") + 1))
    return [f"| {line} |" for line in (head, rule, *map(" | ".join, rows))]


def bold_count(count: int) -> str:
    """Bold where there are any."""
    return f"**{count}**" if count else "0"
