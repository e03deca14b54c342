"""The frame of a chart: scales, grid lines and their labels."""

from collections.abc import Sequence

import numpy as np
from msgspec import Struct
from numpy.typing import ArrayLike

from trigpoint.geometry.rotation import Array

from .svg import drawing, element, group, line, text

LEFT, RIGHT, TOP, BOTTOM = 54.0, 22.0, 14.0, 34.0


class Scale(Struct, frozen=True):
    """From values to one axis of a drawing; `start` and `end` are where `low` and `high` lie."""

    low: float
    high: float
    start: float
    end: float
    is_logarithmic: bool = False

    def __call__(self, values: ArrayLike) -> Array:
        low, high, v = self.low, self.high, np.asarray(values, dtype=float)
        if self.is_logarithmic:
            low, high, v = np.log10(low), np.log10(high), np.log10(np.maximum(v, 1e-12))
        share = np.clip((v - low) / (high - low), 0.0, 1.0)
        return self.start + share * (self.end - self.start)

    def ticks(self, most: int = 6) -> list[float]:
        """Round values within the scale."""
        if self.is_logarithmic:
            first, last = np.ceil(np.log10(self.low)), np.floor(np.log10(self.high))
            return [float(10.0**power) for power in np.arange(first, last + 0.5)]
        step = _round_step((self.high - self.low) / most)
        first = np.ceil(self.low / step - 1e-9)
        count = int(np.floor(self.high / step + 1e-9) - first) + 1
        return [float(step * (first + i)) for i in range(count)]


def _round_step(step: float) -> float:
    power = 10.0 ** np.floor(np.log10(step))
    return float(power * next(n for n in (1, 2, 5, 10) if n * power >= step - 1e-12))


class Axes(Struct, frozen=True):
    width: float
    height: float
    across: Scale
    up: Scale

    @classmethod
    def of(
        cls,
        width: float,
        height: float,
        *,
        x: tuple[float, float],
        y: tuple[float, float],
        is_logarithmic: bool = False,
        right: float = RIGHT,
    ) -> "Axes":
        across = Scale(*x, LEFT, width - right)
        up = Scale(*y, height - BOTTOM, TOP, is_logarithmic)
        return cls(width, height, across, up)

    def points(self, x: ArrayLike, y: ArrayLike) -> Array:
        """(n, 2) in the drawing."""
        return np.stack([self.across(x), self.up(y)], axis=-1)

    def bars(self, counts: np.ndarray, edges: Array) -> list[str]:
        """A histogram: `counts` (n,) between `edges` (n + 1,)."""
        across, tops = self.across(edges), self.up(counts)
        return [
            element(
                "rect", x=across[i] + 0.6, y=tops[i], width=across[i + 1] - across[i] - 1.2,
                height=self.up.start - tops[i], class_="bar", rx=1,
            )
            for i in np.flatnonzero(counts)
        ]  # fmt: skip

    def chart(
        self,
        x_title: str,
        y_title: str,
        *content: str,
        label: str,
        names: Sequence[tuple[str, str]] = (),
    ) -> str:
        """The drawing with its grid, labels and titles below the `content`; `names`: pairs that
        stand at 0, 1, … in place of numbers."""
        frame = self._frame(x_title, y_title, names)
        return drawing(self.width, self.height, frame, *content, label=label, class_="chart")

    def _frame(self, x_title: str, y_title: str, names: Sequence[tuple[str, str]]) -> str:
        left, right = self.across.start, self.across.end
        bottom = self.up.start
        parts = []
        for value in self.up.ticks(5):
            y = float(self.up(value))
            parts.append(line(left, y, right, y, class_="grid"))
            parts.append(text(left - 6, y + 4, f"{value:g}", class_="tick end-anchored"))
        parts += self._names(names) if names else self._numbers()
        parts.append(line(left, bottom, right, bottom, class_="axis"))
        parts.append(text(right, self.height - 4, x_title, class_="axis-title end-anchored"))
        parts.append(text(left + 4, TOP - 3, y_title, class_="axis-title"))
        return group(*parts)

    def _numbers(self) -> list[str]:
        bottom, parts = self.up.start, []
        for value in self.across.ticks():
            x = float(self.across(value))
            parts.append(line(x, bottom, x, bottom + 4, class_="axis"))
            parts.append(text(x, bottom + 17, f"{value:g}", class_="tick middle"))
        return parts

    def _names(self, names: Sequence[tuple[str, str]]) -> list[str]:
        bottom, parts = self.up.start, []
        for place, (above, below) in enumerate(names):
            x = float(self.across(place))
            parts.append(text(x, bottom + 14, above, class_="tick middle"))
            parts.append(text(x, bottom + 28, below, class_="tick middle"))
        return parts
