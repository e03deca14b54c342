"""What becomes of a site that may be too much for one fusion, in the time that it really has:

    python -m benchmarks.fusion.by_the_clock [--cameras 30] [--robots 10] [--pictures 5] \\
        [--minutes 6]

The drive of `scale`, but nothing waits for the solver: messages come by the clock, as they do live.
(They are made beforehand, which takes about as long.) Every half minute a line says
how long after its messages were due a turn of 20 ms was done (so late its corrections are; of the
machine as it is, with whatever else runs on it), how much of the processor the estimator's thread
took for a second of the session, what the solver took of a core, and how long it has owed or took
its last answer. The run ends early where the turns are a minute late.
"""

import argparse
import time
from dataclasses import dataclass, field

import numpy as np

from benchmarks.machine import machine
from trigpoint.base.clock import to_seconds
from trigpoint.fusion.live.memory import return_large_arrays
from trigpoint.fusion.live.solver_process import SolverProcess
from trigpoint.fusion.pipeline import Pipeline

from .corridor import EPOCH_NS, Corridor
from .live import worked_s
from .scale import Turn, taken, turns

_EVERY_S, _MOST_LATE_S = 30.0, 60.0


@dataclass(slots=True)
class Span:
    """Half a minute: how late each turn with sightings was done, and what was worked, seconds."""

    late_s: list[float] = field(default_factory=list)
    spent_s: float = 0.0
    sightings: int = 0

    def told(self, passed_s: float) -> str:
        """For people; `passed_s`: of the session."""
        middle, most = 1e3 * np.percentile(self.late_s or [np.nan], [50, 99])
        return (
            f"{self.sightings / passed_s:.1f} sightings/s done {middle:.0f} ms after due, "
            f"p99 {most:.0f} ms; the thread {100 * self.spent_s / passed_s:.0f} %"
        )


class Questions:
    """What the solver is asked, one at a time, and how long the present answer has taken."""

    def __init__(self, pipeline: Pipeline) -> None:
        self._pipeline, self._asked_s, self.took_s = pipeline, 0.0, float("nan")

    def listen(self) -> None:
        """Ask again where it has answered."""
        if self._asked_s and not self._pipeline.reports.is_answered:
            self.took_s = time.monotonic() - self._asked_s
        else:
            self._pipeline.reports.ask()
            self._asked_s = time.monotonic()


def drive(corridor: Corridor) -> None:
    """Go through the session by the clock, and tell."""
    session = list(turns(corridor))
    solver = SolverProcess(corridor.inputs.data_set())
    try:
        pipeline = Pipeline(corridor.inputs, is_live=False, solver=solver)
        pipeline.resumed(is_new=True)
        _driven(session, pipeline, solver)
    finally:
        solver.close()


def _driven(session: list[tuple[int, Turn]], pipeline: Pipeline, solver: SolverProcess) -> None:
    span, questions, told_s = Span(), Questions(pipeline), 0.0
    began_s = told_at_s = time.monotonic()
    solver_s = worked_s(solver.pid)
    for now_ns, turn in session:
        now_s = to_seconds(now_ns - EPOCH_NS)
        time.sleep(max(0.0, began_s + now_s - time.monotonic()))
        span.spent_s += taken(pipeline, now_ns, turn)
        late_s = time.monotonic() - began_s - now_s
        if seen := sum(has_face for *_, has_face in turn):
            span.sightings += seen
            span.late_s.append(late_s)
        if now_s - told_s >= _EVERY_S or late_s > _MOST_LATE_S:
            questions.listen()
            worked = worked_s(solver.pid) - solver_s
            clock_s = time.monotonic() - told_at_s
            print(
                f"{now_s:5.0f} s: {span.told(now_s - told_s)}, {pipeline.located_count} located; "
                f"the solver {100 * worked / clock_s:.0f} %, last answer {questions.took_s:.0f} s",
                flush=True,
            )
            span, told_s, solver_s = Span(), now_s, solver_s + worked
            told_at_s = time.monotonic()
        if late_s > _MOST_LATE_S:
            print("the turns are a minute late: this is not carried")
            return


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cameras", type=int, default=30)
    parser.add_argument("--robots", type=int, default=10)
    parser.add_argument("--pictures", type=float, default=5.0)
    parser.add_argument("--minutes", type=float, default=6.0)
    given = parser.parse_args()
    return_large_arrays()  # as the command does it
    drive(Corridor(given.cameras, 60 * given.minutes, given.robots, given.pictures, 50.0, True))
    print(machine().summary)


if __name__ == "__main__":
    main()
