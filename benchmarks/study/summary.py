"""What many sessions of one situation say together."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from .measure import Measure


@dataclass(frozen=True, slots=True)
class Ratio:
    """The root of the mean of normalised squares, and its standard error; NaN of nothing."""

    value: float
    error: float

    def told(self, digits: int) -> str:
        """For people."""
        if np.isnan(self.value):
            return "–"
        error = "" if np.isnan(self.error) else f" ± {self.error:.{digits}f}"
        return f"{self.value:.{digits}f}{error}"


@dataclass(frozen=True, slots=True)
class Summary:
    """`efficiency` and `honesty`: over all sessions in which a camera was located; metres and
    seconds are means; `wrong`, `undetermined` and so on: sessions with such a camera."""

    sessions: int
    efficiency: Ratio
    honesty: Ratio
    distance: float
    distance_bound: float
    seconds: float
    wrong: int
    undetermined: int
    left_open: int
    made_up: int


def summary_of(measures: list[Measure]) -> Summary:
    """Of one situation and estimator; at least one measure."""
    return Summary(
        sessions=len(measures),
        efficiency=ratio_of([m.efficiency for m in measures]),
        honesty=ratio_of([m.honesty for m in measures]),
        distance=_mean(measures, lambda m: m.distance),
        distance_bound=_mean(measures, lambda m: m.distance_bound),
        seconds=_mean(measures, lambda m: m.seconds),
        wrong=sum(bool(m.wrong) for m in measures),
        undetermined=sum(bool(m.undetermined) for m in measures),
        left_open=sum(bool(m.left_open) for m in measures),
        made_up=sum(bool(m.made_up) for m in measures),
    )


def page_table(head: str, rows: Iterable[Sequence[str]]) -> list[str]:
    """Lines of Markdown; `head` with its bars."""
    rule = " | ".join(["---"] * (head.count("|") + 1))
    return [f"| {line} |" for line in (head, rule, *map(" | ".join, rows))]


def bold_count(count: int) -> str:
    """Bold where there are any."""
    return f"**{count}**" if count else "0"


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


def _mean(measures: list[Measure], of: Callable[[Measure], float]) -> float:
    return float(np.mean([of(measure) for measure in measures]))
