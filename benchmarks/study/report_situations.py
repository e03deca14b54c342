"""Writes docs/background/accuracy.md from the results."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from .measure import DECIDED_M, GROSS
from .result import Result, Verdict
from .situations import SITUATIONS
from .store import ESTIMATORS
from .summary import Ratio, bold_count, count_of, page_table, ratio_of, write_page

_HEAD = """# Accuracy

```
make study SEEDS={seeds}                     # as many sessions of each situation, and this page
make study SEEDS=5 SITUATIONS=drive     # some
```

Sessions are simulated without pictures in the demo's lab with its noise: corners are projected
through each camera's lens, and get normal noise of 0.15 px. Each one is worked out as `calibrate`
does it. All sessions of a situation have the same true drive; noise, and whatever has a prior, is
drawn anew for each seed. A drive takes 70 s at 0.4 m/s with six cameras at 5 Hz: the shortest way
past every camera and past the first two once more. The longest, with the long drift, takes 230 s.
The floor is flat, and the site file says so (`floor_tilt = 0`, decisions/0676).

- **error / bound**: √ of the mean of eᵀP⁻¹e/6n, where e stacks all 6n errors of the n located
  cameras and P is the joint Cramér-Rao bound for an oracle, who knows which sightings are good,
  which face each shows, when a camera was moved or a robot lifted; priors count as knowledge.
  1 is the best that is possible. ± one standard error.
- **error / own**: the same with the estimator's own joint covariance. 1 is an honest one.
- **distance**: mean error of the distances between cameras, and what the bound expects of it.
- **wrong**: sessions with a located camera that is over {gross:.0f} sigmas of the bound away:
  another face, another way up, the plane's other solution; or that nobody ever saw, or whose
  place the data leave open. **undetermined**: sessions with a camera that was not located though
  its bound is below {decided:.0f} cm and the data decide.
- **rightly**: sessions with a camera that was not located since the data leave its place open.
  A robot that is lifted and then meets only cameras that are new to it may have been lifted
  before any of them: each moment hangs them elsewhere and explains all pictures alike. The bound,
  which knows the moment, does not show that. So an oracle works out each session with the lift in
  every other gap between visits too, over all good sightings; where that costs less than 25 more
  of χ² than the true moment (here it costs below 0.1), a camera that stands elsewhere then is
  left open, and to state its place is a fault.
- **time**: processor seconds of the estimator for a session.

A number in bold misses its goal (1.03 and 0.95 to 1.05 where faces and lenses are known, else 1.10
and 0.9 to 1.1) by more than two standard errors.
"""

_COLUMNS = (
    "sessions | error / bound | error / own | distance, bound (cm) | wrong | undetermined "
    "| time (s)"
)


def write_report(results: Mapping[str, list[Result]], docs: Path) -> Path:
    """Write the page; return its path."""
    of_smoother = {
        name: those
        for name, found in results.items()
        if (those := [result for result in found if result.estimator == "smoother"])
    }
    most = max(map(len, of_smoother.values()))
    head = _HEAD.format(seeds=most, gross=GROSS, decided=100 * DECIDED_M)
    parts = [head, *_situations(of_smoother)]
    if "drive" in of_smoother:
        parts += [_distances(of_smoother["drive"])]
    return write_page(docs / "accuracy.md", [*parts, *_estimators(results)])


def _situations(results: Mapping[str, list[Result]]) -> list[str]:
    rows = [[SITUATIONS[name].title, *_cells(name, found)] for name, found in results.items()]
    every = [result for found in results.values() for result in found]
    words = (
        f"Of {len(every)} sessions {count_of(every, Verdict.WRONG, Verdict.MADE_UP)} have a wrong "
        f"camera, {count_of(every, Verdict.MISSED)} one that is undetermined though the data "
        "decide."
    )
    return [*page_table(f"situation | {_COLUMNS}", rows), "", words, ""]


def _cells(name: str, found: list[Result]) -> list[str]:
    """What some sessions of a situation come to, by `_COLUMNS`."""
    goal, left_open = SITUATIONS[name].goal, count_of(found, Verdict.LEFT_OPEN)
    missed = bold_count(count_of(found, Verdict.MISSED))
    return [
        str(len(found)),
        _ratio(ratio_of(one.efficiency for one in found), 0.0, goal.efficiency),
        _ratio(ratio_of(one.honesty for one in found), *goal.honesty),
        "{:.2f}, {:.2f}".format(*_distances_cm(found)),
        bold_count(count_of(found, Verdict.WRONG, Verdict.MADE_UP)),
        missed + (f", {left_open} rightly" if left_open else ""),
        f"{np.mean([one.seconds for one in found]):.2f}",
    ]


def _ratio(ratio: Ratio, low: float, high: float) -> str:
    text = ratio.told(3)
    allowance = 2 * (0.0 if np.isnan(ratio.error) else ratio.error)
    is_met = low - allowance <= ratio.value <= high + allowance
    return text if is_met else f"**{text}**"


def _distances_cm(found: list[Result]) -> tuple[float, float]:
    """The mean error of distances, and what the bound expects."""
    errors = [(one.distance or 0.0, one.distance_bound or 0.0) for one in found]
    error, bound = 100 * np.mean(errors, axis=0)
    return float(error), float(bound)


def _distances(found: list[Result]) -> str:
    distance, bound = _distances_cm(found)
    return (
        f"## Distances\n\nIn the demo's lab the distances between cameras are off by "
        f"{distance:.2f} cm in the mean; the bound expects {bound:.2f} "
        f"cm, which is a ratio of {distance / bound:.3f}. The paper reached 2.11 cm.\n"
    )


def _estimators(results: Mapping[str, list[Result]]) -> list[str]:
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
    lines = ["## Estimators\n", "On the same sessions:\n", *page_table(head, rows), ""]
    return lines if rows else []
