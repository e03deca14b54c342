"""The figures of docs/background/accuracy.md, as SVG."""

from collections.abc import Callable, Mapping
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from .dance import Point
from .measure import Measure
from .situations import SITUATIONS
from .summary import Ratio, Summary

# Text as text and no dates or random names, so that the same numbers give the same small file.
mpl.use("svg")
mpl.rcParams.update({"svg.fonttype": "none", "svg.hashsalt": "trigpoint", "font.size": 8})
_WIDTH = 7.0
_BAND, _POINT, _OTHER = "#dfe9dc", "#1f5a8a", "#b5542a"


def draw_ratios(path: Path, summaries: Mapping[str, Summary]) -> None:
    """Efficiency and honesty of every situation beside their goals."""
    names = [name for name in SITUATIONS if name in summaries]
    height = 0.6 + 0.2 * len(names)
    _, axes = plt.subplots(1, 2, figsize=(_WIDTH, height), sharey=True)
    rows = np.arange(len(names))
    for row, name in zip(rows, names, strict=True):
        goal = SITUATIONS[name].goal
        axes[0].barh(row, goal.efficiency - 0.5, left=0.5, height=0.8, color=_BAND)
        low, high = goal.honesty
        axes[1].barh(row, high - low, left=low, height=0.8, color=_BAND)
    _points(axes[0], rows, [summaries[n].efficiency for n in names])
    _points(axes[1], rows, [summaries[n].honesty for n in names])
    axes[0].set_yticks(rows, [SITUATIONS[n].title for n in names])
    axes[0].invert_yaxis()
    axes[0].set_xlabel("error, in units of the bound")
    axes[1].set_xlabel("error, in units of its own covariance")
    _save(path)


def _points(axes: Axes, rows: np.ndarray, ratios: list[Ratio]) -> None:
    """Values with two standard errors; what lies beyond the axis stands at its end, in numbers."""
    end = 1.6
    for row, ratio in zip(rows, ratios, strict=True):
        if ratio.value > end:
            axes.text(end, row, f"{ratio.value:.1f} →", ha="right", va="center", color=_OTHER)
        elif np.isfinite(ratio.value):
            axes.errorbar(ratio.value, row, xerr=2 * ratio.error, fmt="o", ms=3, color=_POINT)
    axes.axvline(1.0, color="0.6", lw=0.6)
    axes.set_xlim(0.5, end)


def draw_distances(path: Path, measures: list[Measure]) -> None:
    """The mean error of the distances between cameras in every session of a drive, sorted, beside
    its bound and the paper's."""
    errors = 100 * np.sort([m.distance for m in measures])
    bound = 100 * float(np.mean([m.distance_bound for m in measures]))
    _, axes = plt.subplots(figsize=(_WIDTH, 2.2))
    axes.bar(np.arange(len(errors)), errors, width=0.8, color=_POINT)
    axes.axhline(bound, color=_OTHER, lw=1, label=f"bound of its mean, {bound:.2f} cm")
    axes.axhline(2.11, color="0.4", lw=1, ls="--", label="the paper, 2.11 cm")
    axes.axhline(errors.mean(), color="k", lw=1, ls=":", label=f"mean, {errors.mean():.2f} cm")
    axes.set_xlabel("session, in order of its error")
    axes.set_ylabel("distance error, cm")
    axes.legend(frameon=False)
    _save(path)


def draw_dance(path: Path, points: list[Point]) -> None:
    """What the bound says of the dance and of going around for as long."""
    _, axes = plt.subplots(figsize=(_WIDTH, 2.6))
    kinds: list[tuple[str, Callable[[Point], float], str]] = [
        ("the dance", lambda p: p.dance, _POINT),
        ("going around", lambda p: p.loop, _OTHER),
    ]
    seconds = [p.seconds for p in points]
    for name, of, color in kinds:
        axes.plot(seconds, [100 * of(p) for p in points], "o-", ms=3, color=color, label=name)
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("length of the session, s")
    axes.set_ylabel("bound of the distance error, cm")
    axes.legend(frameon=False)
    _save(path)


def _save(path: Path) -> None:
    plt.tight_layout()
    plt.savefig(path, metadata={"Date": None})
    plt.close()
