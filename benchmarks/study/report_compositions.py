"""Writes docs/background/compositions.md from the scores."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from benchmarks.compositions.recipe import KINDS

from .result import Outcome, Result, Verdict
from .score import GOAL_S, GOAL_SHARE, WRONG_M, WRONG_M_SIGMAS, WRONG_SIGMAS
from .summary import bold_count, count_of, line_of, page_table, ratio_of, write_page

_HEAD = """# Compositions

```
make compositions SEEDS=100              # as many sessions of each kind, and this page
python -m benchmarks study write everything --out DIR --seeds 1:40    # the sessions
```

Everything at once, drawn by the seed: 2 to 12 cameras in drawn rooms, one to three robots, every
pattern on three shapes of target, faces alike or known, one picture a stop or 5 to 10 Hz;
displaced, misnamed and wild sightings, unknown lenses, time offsets, scales and mountings, moved
cameras, lifted robots, gaps, late and doubled messages; and, where the model is wrong, a floor
that tilts by 0.3°, a target that sways by 1 mm, wheels that slip in bursts, noise of half or twice
what the site file says, heavy tails. Sessions are drawn forwards by a simulator that shares
nothing with fusion; `calibrate` works out each from its files, as a user would.

- **wrong**: sessions with a located camera whose position is over {sigmas:.0f} of its own sigmas
  off, or {far:.0f} cm and {far_sigmas:.0f} sigmas. **late**: over the limit of processor time.
  **failed**: no network. **slow**: over {goal:.0f} s and {share:.0%} of the session's length.
- **honesty**: √ of the mean of eᵀP⁻¹e/6n with the network's own joint covariance; 1 is right.
- **located**: of the cameras with a sighting that is not wrong as a whole, by whether two or more
  pictures show the place where a camera hangs at last, or one. Not all of the others could be
  located: where equal faces, or a lift, leave a place open, «undetermined» is the right answer.
"""


def write_report(scores: Mapping[str, list[Result]], docs: Path) -> Path:
    """Write the page; return its path."""
    head = _HEAD.format(
        sigmas=WRONG_SIGMAS,
        far=100 * WRONG_M,
        far_sigmas=WRONG_M_SIGMAS,
        goal=GOAL_S,
        share=GOAL_SHARE,
    )
    found = {kind: of_kind for kind, of_kind in scores.items() if of_kind}
    parts = [head, *summary_lines(found), "", *_bad(found), ""]
    return write_page(docs / "compositions.md", parts)


def summary_lines(scores: Mapping[str, list[Result]]) -> list[str]:
    """Two tables: of sessions, and of cameras by category."""
    return [*_of_sessions(scores), "", *_of_cameras(scores)]


def _of_sessions(scores: Mapping[str, list[Result]]) -> list[str]:
    head = "sessions | number | wrong | late | failed | slow | honesty | median, longest (s)"
    everything = [score for of_kind in scores.values() for score in of_kind]
    rows = {KINDS[kind].title: of_kind for kind, of_kind in scores.items()}
    rows["all where the model is right"] = [s for s in everything if not s.is_mismatched]
    rows["all where it is not"] = [s for s in everything if s.is_mismatched]
    cells = [[title, *_session_cells(of_row)] for title, of_row in rows.items() if of_row]
    return page_table(head, cells)


def _session_cells(scores: list[Result]) -> list[str]:
    seconds = [score.seconds for score in scores]
    counts = [
        count_of(scores, Verdict.WRONG),
        sum(score.outcome is Outcome.LATE for score in scores),
        sum(score.outcome is Outcome.FAILED for score in scores),
        sum(one.seconds > GOAL_S + GOAL_SHARE * one.lasts_s for one in scores),
    ]
    return [
        str(len(scores)),
        *map(bold_count, counts),
        ratio_of([score.honesty for score in scores]).told(2),
        f"{np.median(seconds):.1f}, {max(seconds):.1f}",
    ]


_CATEGORIES: dict[str, Callable[[Result], bool]] = {
    "known faces": lambda score: not score.is_alike and not score.lifts,
    "known faces, a lift": lambda score: not score.is_alike and bool(score.lifts),
    "equal faces": lambda score: score.is_alike and not score.lifts,
    "equal faces, a lift": lambda score: score.is_alike and bool(score.lifts),
}


def _of_cameras(scores: Mapping[str, list[Result]]) -> list[str]:
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
                bold_count(wrong),
                f"{len(unconfirmed)}, {sum(c.verdict is Verdict.WRONG for c in unconfirmed)}",
                _missed([c.among for c in cameras if c.among is not None]),
            ]
            rows.append(cells)
    return page_table(head, rows)


def _missed(among: list[bool]) -> str:
    return f"{sum(not found for found in among)} of {len(among)}" if among else "–"


def _bad(scores: Mapping[str, list[Result]]) -> list[str]:
    """Each session that is wrong, late or failed."""
    bad = [score for of_kind in scores.values() for score in of_kind if score.is_bad]
    return ["Sessions to look at:\n", *(f"- {line_of(score)}" for score in bad)] if bad else []
