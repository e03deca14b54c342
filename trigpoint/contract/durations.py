"""Histograms of durations, as a node's diagnostics hold them: `NAME.seconds`."""

from bisect import bisect_left
from collections.abc import Sequence
from typing import Self

from msgspec import Struct, field

BOUNDS_S = (
    *(0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5),
    *(1.0, 2.5, 5.0, 10.0, 25.0, 50.0, 100.0, 250.0),
)
"""How long what is counted took at most, seconds; the last count is of what took longer."""


def _zeros() -> list[int]:
    return [0] * (len(BOUNDS_S) + 1)


class Durations(Struct):
    """How many took how long. `counts`: one for each of BOUNDS_S and one beyond, not cumulative."""

    sum_s: float = 0.0
    counts: list[int] = field(default_factory=_zeros)

    def add(self, seconds: float) -> None:
        """Count one; one that ended before it began, by two machines' clocks, took no time."""
        self.sum_s += max(0.0, seconds)
        self.counts[bisect_left(BOUNDS_S, seconds)] += 1

    @property
    def text(self) -> str:
        """The sum, and the counts up to the last that is not zero."""
        last = max((at for at, count in enumerate(self.counts) if count), default=-1)
        return " ".join([f"{self.sum_s:.6f}", *map(str, self.counts[: last + 1])])

    @classmethod
    def of(cls, text: str) -> Self:
        """Read `text`; raise ValueError where it is none."""
        sum_s, *counts = text.split(" ")
        found = cls(float(sum_s), _filled([int(count) for count in counts]))
        if not found.sum_s >= 0.0 or min(found.counts) < 0:
            raise ValueError(f"«{text}» is no histogram of durations")
        return found


def _filled(counts: Sequence[int]) -> list[int]:
    if len(counts) > len(BOUNDS_S) + 1:
        raise ValueError("there are more counts than bounds")
    return [*counts, *_zeros()[len(counts) :]]
