"""What many sessions say together: a line of each, and the tables in docs/background, accuracy.md
of situations and compositions.md of compositions.

A page is written by people; what stands there between `BEGIN` and `END` is replaced.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from msgspec import Struct

from benchmarks.compositions.recipe import KINDS
from benchmarks.report import machine

from .result import Outcome, Result, Verdict
from .situations import SITUATIONS
from .store import ESTIMATORS

BEGIN, END = "<!-- what the study found -->", "<!-- end of what it found -->"
GOAL_S, GOAL_SHARE = 10.0, 0.1  # of processor time: so much, and a share of the session's length
_COLUMNS = (
    "sessions | error / bound | error / own | distance, bound (cm) | wrong | undetermined "
    "| time (s)"
)
_Found = Mapping[str, list[Result]]


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


def write_situations(results: _Found, docs: Path) -> Path:
    """Put the situations' tables into their page; return its path."""
    of_smoother = {
        name: those
        for name, found in results.items()
        if (those := [result for result in found if result.estimator == "smoother"])
    }
    parts = [*_situations(of_smoother), *_to_look_at(of_smoother)]
    if "drive" in of_smoother:
        parts += _distances(of_smoother["drive"])
    return _written(docs / "accuracy.md", [*parts, *_estimators(results)])


def write_compositions(scores: _Found, docs: Path) -> Path:
    """Put the compositions' tables into their page; return its path."""
    found = {kind: of_kind for kind, of_kind in scores.items() if of_kind}
    parts = [*_of_sessions(found), "", *_of_cameras(found), "", *_to_look_at(found)]
    return _written(docs / "compositions.md", parts)


def _to_look_at(results: _Found) -> list[str]:
    """A line of each session that has a false place, or no network."""
    bad = [one for found in results.values() for one in found if one.is_bad]
    lines = ["Sessions to look at:\n", *(f"- {line_of(one)}" for one in bad), ""]
    return lines if bad else []


def _written(path: Path, parts: Iterable[str]) -> Path:
    """Replace what stands between the two marks, which are added where there are none; raise
    ValueError where the second is missing, since what people wrote would end there."""
    path.parent.mkdir(parents=True, exist_ok=True)
    page = path.read_text(encoding="utf-8") if path.exists() else ""
    before, begin, rest = page.partition(BEGIN)
    if begin and END not in rest:
        raise ValueError(f"{path}: «{BEGIN}» without «{END}»; write that where the tables end")
    after = rest.partition(END)[2] or "\n"
    lines = [BEGIN, "", *parts, f"Measured on {machine().summary}.", END]
    path.write_text(before + "\n".join(lines) + after, encoding="utf-8")
    return path


def _table(head: str, rows: Iterable[Sequence[str]]) -> list[str]:
    """Lines of Markdown; `head` with its bars."""
    rule = " | ".join(["---"] * (head.count("|") + 1))
    return [f"| {line} |" for line in (head, rule, *map(" | ".join, rows))]


def _bold_count(count: int) -> str:
    """Bold where there are any."""
    return f"**{count}**" if count else "0"


def _situations(results: _Found) -> list[str]:
    rows = [[SITUATIONS[name].title, *_cells(name, found)] for name, found in results.items()]
    every = [result for found in results.values() for result in found]
    words = (
        f"Of {len(every)} sessions {count_of(every, Verdict.WRONG, Verdict.MADE_UP)} have a wrong "
        f"camera, {count_of(every, Verdict.MISSED)} one that is undetermined though the data "
        "decide."
    )
    return [*_table(f"situation | {_COLUMNS}", rows), "", words, ""]


def _cells(name: str, found: list[Result]) -> list[str]:
    """What some sessions of a situation come to, by `_COLUMNS`."""
    goal, left_open = SITUATIONS[name].goal, count_of(found, Verdict.LEFT_OPEN)
    missed = _bold_count(count_of(found, Verdict.MISSED))
    distances, seconds = _distances_cm(found), _seconds(found)
    without = len(found) - len(seconds)
    return [
        str(len(found)) + (f", {without} without a network" if without else ""),
        _ratio(ratio_of(one.efficiency for one in found), 0.0, goal.efficiency),
        _ratio(ratio_of(one.honesty for one in found), *goal.honesty),
        "{:.2f}, {:.2f}".format(*distances) if distances else "–",
        _bold_count(count_of(found, Verdict.WRONG, Verdict.MADE_UP)),
        missed + (f", {left_open} rightly" if left_open else ""),
        f"{np.mean(seconds):.2f}" if seconds else "–",
    ]


def _ratio(ratio: Ratio, low: float, high: float) -> str:
    """Bold where it misses its goal by more than two standard errors."""
    text = ratio.told(3)
    allowance = 2 * (0.0 if np.isnan(ratio.error) else ratio.error)
    is_met = low - allowance <= ratio.value <= high + allowance
    return text if is_met else f"**{text}**"


def _seconds(found: list[Result]) -> list[float]:
    """Of the sessions that have a network: the others ended, or were ended, on their way."""
    return [one.seconds for one in found if one.outcome is Outcome.DONE]


def _distances_cm(found: list[Result]) -> tuple[float, float] | None:
    """The mean error of distances, and what the bound expects, over the sessions that have any;
    None where none has."""
    errors = [
        (one.distance, one.distance_bound)
        for one in found
        if one.distance is not None and one.distance_bound is not None
    ]
    if not errors:
        return None
    error, bound = 100 * np.mean(errors, axis=0)
    return float(error), float(bound)


def _distances(found: list[Result]) -> list[str]:
    if (distances := _distances_cm(found)) is None:
        return []
    distance, bound = distances
    words = (
        f"## Distances\n\nIn the demo's lab the distances between cameras are off by "
        f"{distance:.2f} cm in the mean; the bound expects {bound:.2f} "
        f"cm, which is a ratio of {distance / bound:.3f}. The paper reached 2.11 cm.\n"
    )
    return [words]


def _estimators(results: _Found) -> list[str]:
    """One table of all estimators over the sessions that all of them worked out."""
    rows = []
    for name, found in results.items():
        by = {e: {one.seed: one for one in found if one.estimator == e} for e in ESTIMATORS}
        present = [e for e in ESTIMATORS if by[e]]
        seeds = sorted(set.intersection(*(set(by[e]) for e in present))) if present else []
        for estimator in present if len(present) > 1 and seeds else []:
            shared = [by[estimator][seed] for seed in seeds]
            rows.append([SITUATIONS[name].title, estimator, *_cells(name, shared)])
    head = f"situation | estimator | {_COLUMNS}"
    lines = ["## Estimators\n", "On the same sessions:\n", *_table(head, rows), ""]
    return lines if rows else []


def _of_sessions(scores: _Found) -> list[str]:
    head = "sessions | number | wrong | late | failed | slow | honesty | median, longest (s)"
    everything = [score for of_kind in scores.values() for score in of_kind]
    rows = {KINDS[kind].title: of_kind for kind, of_kind in scores.items()}
    rows["all where the model is right"] = [s for s in everything if not s.is_mismatched]
    rows["all where it is not"] = [s for s in everything if s.is_mismatched]
    cells = [[title, *_session_cells(of_row)] for title, of_row in rows.items() if of_row]
    return _table(head, cells)


def _session_cells(scores: list[Result]) -> list[str]:
    seconds = _seconds(scores)
    counts = [
        count_of(scores, Verdict.WRONG),
        sum(score.outcome is Outcome.LATE for score in scores),
        sum(score.outcome is Outcome.FAILED for score in scores),
        sum(one.seconds > GOAL_S + GOAL_SHARE * one.lasts_s for one in scores),
    ]
    return [
        str(len(scores)),
        *map(_bold_count, counts),
        ratio_of([score.honesty for score in scores]).told(2),
        f"{np.median(seconds):.1f}, {max(seconds):.1f}" if seconds else "–",
    ]


_CATEGORIES: dict[str, Callable[[Result], bool]] = {
    "known faces": lambda score: not score.is_alike and not score.lifts,
    "known faces, a lift": lambda score: not score.is_alike and bool(score.lifts),
    "equal faces": lambda score: score.is_alike and not score.lifts,
    "equal faces, a lift": lambda score: score.is_alike and bool(score.lifts),
}


def _of_cameras(scores: _Found) -> list[str]:
    """Located of all, and how many of these are wrong, by category."""
    head = (
        "located cameras | two pictures or more | one picture | wrong "
        "| unconfirmed, wrong of them | truth not among the alternatives"
    )
    rows = []
    for kind, of_kind in scores.items():
        for category, belongs in _CATEGORIES.items():
            cameras = [c for score in of_kind if belongs(score) for c in score.cameras]
            if not cameras:
                continue
            often = [camera for camera in cameras if camera.pictures >= 2]
            once = [camera for camera in cameras if camera.pictures < 2]
            wrong = sum(camera.verdict is Verdict.WRONG for camera in cameras)
            unconfirmed = [c for c in cameras if c.is_located and not c.is_confirmed]
            cells = [
                f"{kind}: {category}",
                f"{sum(c.is_located for c in often)} of {len(often)}",
                f"{sum(c.is_located for c in once)} of {len(once)}",
                _bold_count(wrong),
                f"{len(unconfirmed)}, {sum(c.verdict is Verdict.WRONG for c in unconfirmed)}",
                _missed([c.among for c in cameras if c.among is not None]),
            ]
            rows.append(cells)
    return _table(head, rows)


def _missed(among: list[bool]) -> str:
    return f"{sum(not found for found in among)} of {len(among)}" if among else "–"
