"""Writes what is known when fusion stops: solved to the end where that is quick enough."""

import logging
import time
from pathlib import Path

from trigpoint.base.clock import Clock, to_ns
from trigpoint.base.ending import ENDING
from trigpoint.base.errors import OperationError

from .pipeline import Pipeline

WRITING_S = 0.5
"""A stop may take two seconds in all (`base.ending`), of which files and the bus need so much."""
_LAST_SOLUTION_S = 1.2
# Where the estimator solves within its turn: the last solution takes several times the longest one.
_LONG_TURN_S = 0.25
_LOOK_S = 0.01

_log = logging.getLogger(__name__)


def save_last(pipeline: Pipeline, out: Path, clock: Clock, *, turn_s: float | None) -> None:
    """Write the results to a folder; `turn_s`: how long a turn took at most where the estimator
    solves within its turn, None where a solver does it."""
    if turn_s is None:
        is_final = _is_solved_in_time(pipeline, clock)
    else:
        # What is known now is kept first: whoever stops us may not wait for the last solution.
        with ENDING.writing():
            pipeline.results().save(out)
        if is_final := turn_s < _LONG_TURN_S:
            pipeline.finish()
    if not is_final:
        _log.warning(
            "the last solution would take longer than a stop may; the previous one is kept; "
            "run `trigpoint calibrate` over the recording for the last one"
        )
    if not pipeline.reports.has_results:
        _log.warning("no network is written: there is no solution yet")
        return
    with ENDING.writing():
        pipeline.results().save(out)
    _log.info("the network is in %s", out / "network.json")


def _is_solved_in_time(pipeline: Pipeline, clock: Clock) -> bool:
    """Have the solver solve to the end; whether it did within the time that a stop may take."""
    within_s = min(_LAST_SOLUTION_S, ENDING.left_s(WRITING_S))
    until_ns = clock.elapsed_ns() + to_ns(within_s)
    try:
        pipeline.finish()
        while not pipeline.reports.is_answered and clock.elapsed_ns() < until_ns:
            time.sleep(_LOOK_S)
            pipeline.advance()
    except OperationError as reason:
        _log.error("%s", reason)
    return pipeline.reports.is_answered and pipeline.reports.is_final
