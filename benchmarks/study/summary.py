"""What many sessions of one situation say together, and how a page shows it."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from msgspec import Struct

from benchmarks.machine import machine

from .result import Outcome, Result, Verdict


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


def count_of(results: Iterable[Result], *verdicts: Verdict) -> int:
    """How many sessions have a camera that is one of these."""
    return sum(bool(result.those(*verdicts)) for result in results)


def page_table(head: str, rows: Iterable[Sequence[str]]) -> list[str]:
    """Lines of Markdown; `head` with its bars."""
    rule = " | ".join(["---"] * (head.count("|") + 1))
    return [f"| {line} |" for line in (head, rule, *map(" | ".join, rows))]


def bold_count(count: int) -> str:
    """Bold where there are any."""
    return f"**{count}**" if count else "0"


def line_of(result: Result) -> str:
    """One session in a line."""
    located = sum(camera.is_located for camera in result.cameras)
    said = [f"{located}/{len(result.cameras)} located, {result.seconds:.2f} s"]
    for what, square in (("bound", result.efficiency), ("own", result.honesty)):
        said += [f"error/{what} {np.sqrt(square):.3f}"] if square is not None else []
    if result.distance is not None and result.distance_bound is not None:
        expected = 100 * result.distance_bound
        said.append(f"distance {100 * result.distance:.2f} of {expected:.2f} cm")
    for camera in result.cameras:
        if camera.verdict not in (Verdict.RIGHT, Verdict.UNKNOWN):
            said.append(f"{camera.name} {camera.verdict}")
        if camera.verdict is Verdict.WRONG and camera.error_m is not None:
            said[-1] += f" by {100 * camera.error_m:.0f} cm ({camera.sigmas:.0f} sigmas)"
        if camera.is_moved:
            said.append(f"{camera.name} moved")
    said += [f"{result.rejected} rejected"] if result.rejected else []
    if result.outcome is not Outcome.DONE:
        said.append(f"{result.outcome} {result.why}".rstrip())
    return f"{result.session} {result.seed} {result.estimator}: {', '.join(said)}"


def write_page(path: Path, parts: Iterable[str]) -> Path:
    """Write a page, with the machine; return its path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = [*parts, f"Measured on {machine().summary}."]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path
