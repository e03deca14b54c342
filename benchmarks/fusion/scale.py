"""What one fusion carries: its share of a core and its updates, by cameras, robots and rates.

    python -m benchmarks.fusion.scale [--cameras 10 30] [--robots 1 3 10] [--pictures 5 10]

Robots drive round a ring of cameras, each with a target of its own and odometry at 50 Hz; every
camera tells of each of its pictures, also of empty ones. After the first lap all cameras are
located; the next fifth of a lap is measured. Messages are taken as the node takes them, in turns of
20 ms of the session: decoded, fused, corrections encoded. Times are the processor's, so that a
busy machine changes little; the last column is how many sightings with a face a second would fill
the estimator's thread, with what its other messages cost beside them.
"""

import argparse
import itertools
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks.machine import machine
from trigpoint.base.clock import to_ns, to_seconds
from trigpoint.contract import cdr
from trigpoint.contract.messages import Sightings
from trigpoint.fusion.inbox import INPUT_TOPICS, Input
from trigpoint.fusion.live.memory import return_large_arrays
from trigpoint.fusion.live.solver_process import SolverProcess
from trigpoint.fusion.pipeline import Pipeline

from .corridor import EPOCH_NS, Corridor
from .live import worked_s

_TURN_NS = to_ns(0.02)
_MEASURED_LAPS = 0.2
# So far the session runs ahead of its solver at most.
_LEAD_NS = to_ns(30.0)
Turn = list[tuple[str, str, bytes, bool]]
"""Node, type, payload, and whether there is a face in it."""


@dataclass(frozen=True, slots=True)
class Load:
    """What the measured part of a session cost. Milliseconds of the processor."""

    corridor: Corridor
    located: int
    seconds: float
    messages: int
    sightings: int
    updates_ms: np.ndarray
    spent_s: float
    solver_s: float

    @property
    def row(self) -> str:
        corridor, seconds = self.corridor, self.seconds
        middle, most = np.percentile(self.updates_ms, [50, 99])
        share = self.spent_s / seconds
        return (
            f"| {corridor.cameras} × {corridor.pictures_hz:g} Hz | {corridor.robots} "
            f"| {self.messages / seconds:.0f} | {self.sightings / seconds:.1f} "
            f"| {100 * share:.0f} % | {100 * self.solver_s / seconds:.0f} % "
            f"| {middle:.1f}, {most:.1f} ms | {self.sightings / self.spent_s:.0f} "
            f"| {self.located} |"
        )


def measured(corridor: Corridor) -> Load:
    """Drive, and say what the time after the first lap costs."""
    inputs = corridor.inputs
    solver = SolverProcess(inputs.data_set())
    try:
        pipeline = Pipeline(inputs, is_live=False, solver=solver)
        pipeline.resumed(is_new=True)
        return _driven(corridor, pipeline, solver)
    finally:
        solver.close()


def _driven(corridor: Corridor, pipeline: Pipeline, solver: SolverProcess) -> Load:
    from_ns, asked_ns = EPOCH_NS + to_ns(corridor.lap_s), EPOCH_NS
    updates, spent_s, messages, sightings, solver_s = list[float](), 0.0, 0, 0, 0.0
    now_ns = EPOCH_NS
    for now_ns, turn in turns(corridor):
        took_s = taken(pipeline, now_ns, turn)
        if now_ns >= from_ns:
            solver_s = solver_s or worked_s(solver.pid)
            seen = sum(has_face for *_, has_face in turn)
            messages, sightings, spent_s = messages + len(turn), sightings + seen, spent_s + took_s
            if seen:
                updates.append(1e3 * took_s)
        if now_ns - asked_ns >= _LEAD_NS:
            asked_ns = now_ns
            _wait(pipeline)
    return Load(
        corridor,
        pipeline.located_count,
        to_seconds(now_ns - from_ns),
        messages,
        sightings,
        np.array(updates),
        spent_s,
        worked_s(solver.pid) - solver_s,
    )


def turns(corridor: Corridor) -> Iterator[tuple[int, Turn]]:
    """The session cut into turns: until when, and what came."""
    until_ns, turn = EPOCH_NS + _TURN_NS, Turn()
    for node, message in corridor.messages():
        while message.stamp_ns >= until_ns:
            yield until_ns, turn
            until_ns, turn = until_ns + _TURN_NS, Turn()
        turn.append((node, *_encoded(message)))


def _encoded(message: Input) -> tuple[str, bytes, bool]:
    topic = INPUT_TOPICS[type(message)]
    has_face = isinstance(message, Sightings) and bool(message.faces)
    return topic.type_name, cdr.encode(message), has_face


def taken(pipeline: Pipeline, now_ns: int, turn: Turn) -> float:
    """What one turn takes of the processor, seconds."""
    begin_s = time.thread_time()
    for node, type_name, payload, _ in turn:
        pipeline.push(node, cdr.decode(type_name, payload))
    for output in pipeline.advance(now_ns):
        cdr.encode(output.message)
    return time.thread_time() - begin_s


def _wait(pipeline: Pipeline) -> None:
    """Until the solver has done everything that it was told."""
    pipeline.reports.ask()
    while not pipeline.reports.is_answered:
        time.sleep(0.05)
        pipeline.advance()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cameras", type=int, nargs="+", default=[10, 30])
    parser.add_argument("--robots", type=int, nargs="+", default=[1, 3, 10])
    parser.add_argument("--pictures", type=float, nargs="+", default=[5.0, 10.0])
    given = parser.parse_args()
    return_large_arrays()  # as the command does it
    print(
        "| cameras | robots | messages/s | sightings/s | thread | solver | update p50, p99 ", end=""
    )
    print("| sightings/s at most | located |")
    for cameras, robots, rate in itertools.product(given.cameras, given.robots, given.pictures):
        lap_s = Corridor(cameras, 0.0).lap_s
        corridor = Corridor(cameras, (1 + _MEASURED_LAPS) * lap_s, robots, rate, 50.0, True)
        print(measured(corridor).row, flush=True)
    print(machine().summary)


if __name__ == "__main__":
    main()
