"""Has what is known solved: for an answer, and to be written when fusion stops."""

import logging
import threading
import time
from collections.abc import Callable
from pathlib import Path

from trigpoint.base.clock import Clock, to_ns
from trigpoint.base.ending import ENDING
from trigpoint.base.errors import OperationError

from .estimators.results import Results
from .fair_lock import FairLock
from .pipeline import Pipeline

ANSWER_S = 2.0
"""How long a command waits for what it asks for."""
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
    has_results = pipeline.reports.has_results
    if not is_final:
        _log.warning(
            "the last solution would take longer than a stop may; %s; "
            "run `trigpoint calibrate` over the recording for the last one",
            "the previous one is kept" if has_results else "no network is written",
        )
    if not has_results:
        return
    with ENDING.writing():
        pipeline.results().save(out)
    _log.info("the network is in %s", out / "network.json")


def solved(
    now: Callable[[], Pipeline], lock: FairLock, clock: Clock, stopping: threading.Event
) -> Results:
    """The results of the pipeline of now, as it knows them; raise OperationError where there are
    none yet. A solver answers once its current work is done; until then the last answer holds."""
    with lock:
        pipeline = now()
        pipeline.reports.ask()
    _wait(pipeline, clock, ANSWER_S, stopping.wait)
    with lock:
        return pipeline.results()


def _is_solved_in_time(pipeline: Pipeline, clock: Clock) -> bool:
    """Have the solver solve to the end; whether it did within the time that a stop may take."""

    def pause(seconds: float) -> None:
        time.sleep(seconds)
        pipeline.advance()

    within_s = min(_LAST_SOLUTION_S, ENDING.left_s(WRITING_S))
    try:
        pipeline.finish()
        _wait(pipeline, clock, within_s, pause)
    except OperationError as reason:
        _log.error("%s", reason)
    return pipeline.reports.is_answered and pipeline.reports.is_final


def _wait(
    pipeline: Pipeline, clock: Clock, within_s: float, pause: Callable[[float], bool | None]
) -> None:
    """Wait for the solver's answer, unless a pause says that it is in vain."""
    until_ns = clock.elapsed_ns() + to_ns(within_s)
    while not pipeline.reports.is_answered and clock.elapsed_ns() < until_ns:
        if pause(_LOOK_S):
            return
