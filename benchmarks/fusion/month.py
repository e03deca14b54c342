"""Live fusion day after day: what grows with the age of a map?

    python -m benchmarks month [--days D] [--hours H]

Each day a robot is switched on at the same place, its odometry anew, and drives H hours past thirty
cameras with 1 sighting a second and odometry at 20 Hz; at night nothing comes. Messages come as
quickly as they are used, and the solver is waited for after every 30 s of the session. Memory is
what is resident, the checkpoint all files of the map, each the most of its day, sampled every 30 s;
a solution is the solver's processor time of the day by the number of its solutions, and an error
that of a camera's position, in units of its covariance (3 is what is to be expected).
"""

import time
from collections.abc import Iterator
from itertools import groupby
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import numpy as np
import typer
from msgspec import Struct
from msgspec.structs import replace

from benchmarks.table import Row
from benchmarks.timing import in_new_process, resident_mb, worked_s
from trigpoint.base.clock import SystemClock, to_ns, to_seconds
from trigpoint.contract import cdr
from trigpoint.contract.messages import Sightings
from trigpoint.contract.topics import topic_of
from trigpoint.fusion.inbox import INPUT_TOPICS, Input
from trigpoint.fusion.live.memory import return_large_arrays
from trigpoint.fusion.live.solver_process import SolverProcess
from trigpoint.fusion.map_storage import MapStorage
from trigpoint.fusion.pipeline import Pipeline
from trigpoint.tools.simulation.session import EPOCH_NS

from .corridor import Corridor

_CAMERAS, _PICTURES_HZ = 30, 20.0 / 14  # of which 0.7 see the robot
_DAY_NS, _TURN_NS, _SAMPLE_NS = to_ns(24 * 3600.0), to_ns(0.02), to_ns(30.0)
_POLL_S = 0.02
_SENT_AT_ONCE = 512

Turn = tuple[int, list[tuple[str, str, bytes]]]
"""Until when, and node, key and payload of what came."""


class Day(Struct):
    """What a day, or what there was of it, came to: hours driven, sightings, and what is above."""

    number: int
    hours: float = 0.0
    sightings: int = 0
    solutions: int = 0
    estimator_mb: float = 0.0
    solver_mb: float = 0.0
    checkpoint_mb: float = 0.0
    thread_s: float = 0.0
    solver_s: float = 0.0
    pasts: int = 0
    located: int = 0
    errors: float = float("nan")

    @property
    def solution_s(self) -> float:
        """The solver's work by solution."""
        return self.solver_s / max(self.solutions, 1)

    def __str__(self) -> str:
        return (
            f"day {self.number}, {self.hours:.2f} h: {self.sightings} sightings; "
            f"{self.estimator_mb:.0f} + {self.solver_mb:.0f} MB, checkpoint "
            f"{self.checkpoint_mb:.1f} MB; {self.solutions} solutions of {self.solution_s:.2f} s, "
            f"thread {self.thread_s:.0f} s; {self.pasts} summaries; {self.located} located, "
            f"χ² of positions {self.errors:.2f}"
        )


def main(
    days: Annotated[int, typer.Option(help="How many.")] = 30,
    hours: Annotated[float, typer.Option(help="Of driving a day.")] = 8.0,
) -> list[Row]:
    """Drive for days, and say what each came to."""
    found = in_new_process(_driven, days, hours)
    second, last = found[min(1, len(found) - 1)], found[-1]
    what, against = f"day {last.number}", f"day {second.number}"
    return [
        Row("month", f"{what}, {name}", unit, getattr(last, field), getattr(second, field), against)
        for name, unit, field in (
            ("the estimator's memory", "MB", "estimator_mb"),
            ("its solver's", "MB", "solver_mb"),
            ("the checkpoint", "MB", "checkpoint_mb"),
            ("a solution", "s", "solution_s"),
        )
    ]


def _driven(days: int, hours: float) -> list[Day]:
    return_large_arrays()  # as the command does it
    context = get_context("spawn")
    theirs, ours = context.Pipe()
    maker = context.Process(target=_made, args=(ours, days, hours), daemon=True)
    maker.start()
    ours.close()
    with TemporaryDirectory() as folder:
        drive = _Drive(Path(folder))
        try:
            return drive.go(_received(theirs))
        finally:
            drive.close()
            maker.kill()


class _Drive:
    """Feeds a pipeline, and notes what its days come to."""

    def __init__(self, folder: Path) -> None:
        corridor = Corridor(_CAMERAS, 0.0)
        inputs = corridor.inputs
        self._truth = {f"c{i}": corridor.camera(i).translation for i in range(_CAMERAS)}
        self._solutions = 0
        self._solver = SolverProcess(inputs.data_set(), took=self._count)
        self._folder = folder
        self._storage = MapStorage(folder, inputs.site, SystemClock(), knows=lambda _: True)
        self._pipeline = Pipeline(inputs, is_live=False, solver=self._solver)
        self._pipeline.resumed(is_new=True)
        self._past = self._pipeline.past

    def _count(self, _seconds: float) -> None:
        self._solutions += 1

    def go(self, turns: Iterator[Turn]) -> list[Day]:
        """All of it."""
        return [
            self._day(Day(number + 1), of_day)
            for number, of_day in groupby(turns, lambda turn: (turn[0] - EPOCH_NS) // _DAY_NS)
        ]

    def _day(self, day: Day, turns: Iterator[Turn]) -> Day:
        worked, before = worked_s(self._solver.pid), self._solutions
        for _, some in groupby(turns, lambda turn: turn[0] // _SAMPLE_NS):
            for turn in some:
                self._take(day, *turn)
            self._sample(day)
            day.solver_s = worked_s(self._solver.pid) - worked
            day.solutions = self._solutions - before
            if round(day.hours * 120) % 30 == 0:
                typer.echo(str(day), err=True)
        typer.echo(f"ended: {day}", err=True)
        return day

    def _take(self, day: Day, now_ns: int, came: list[tuple[str, str, bytes]]) -> None:
        began_s, kept = time.thread_time(), list[tuple[str, bytes, Input]]()
        for node, key, payload in came:
            topic = topic_of(key)
            assert topic is not None
            message = cdr.decode(topic.type_name, payload)
            day.sightings += isinstance(message, Sightings)
            if self._pipeline.push(node, message):
                kept.append((key, payload, message))  # pyright: ignore[reportArgumentType]
        for output in self._pipeline.advance(now_ns):
            cdr.encode(output.message)
        for key, payload, message in kept:
            self._storage.store(key, payload, message)
        self._storage.settle(self._pipeline.past)
        self._storage.flush()
        if self._pipeline.past is not self._past:
            self._past, day.pasts = self._pipeline.past, day.pasts + 1
        day.thread_s += time.thread_time() - began_s
        day.hours = to_seconds((now_ns - EPOCH_NS) % _DAY_NS) / 3600

    def _sample(self, day: Day) -> None:
        """Wait for the solver, and note what there is."""
        self._pipeline.reports.ask()
        while not self._pipeline.reports.is_answered:
            time.sleep(_POLL_S)
            self._pipeline.advance()
        stored = sum(path.stat().st_size for path in self._folder.glob("*.bin")) / 1e6
        day.estimator_mb = max(day.estimator_mb, resident_mb("self"))
        day.solver_mb = max(day.solver_mb, resident_mb(self._solver.pid))
        day.checkpoint_mb = max(day.checkpoint_mb, stored)
        day.located, day.errors = self._pipeline.located_count, self._squared_error()

    def _squared_error(self) -> float:
        """The mean of the located cameras' squared errors of position by their covariances."""
        found = []
        for name, camera in self._pipeline.results().network.cameras.items():
            if camera.map_from_camera is not None:
                error = camera.map_from_camera.pose.translation - self._truth[name]
                spread = camera.covariance_matrix[:3, :3]
                found.append(float(error @ np.linalg.solve(spread, error)))
        return float(np.mean(found)) if found else float("nan")

    def close(self) -> None:
        """End the solver."""
        self._solver.close()
        self._storage.close()


# -- in the process that makes the messages -------------------------------------------------------


def _made(to: Connection, days: int, hours: float) -> None:
    some: list[Turn] = []
    for number in range(days):
        for turn in _turns(Corridor(_CAMERAS, 3600 * hours, pictures_hz=_PICTURES_HZ), number):
            some.append(turn)
            if len(some) == _SENT_AT_ONCE:
                to.send(some)
                some = []
    to.send(some)
    to.close()


def _turns(corridor: Corridor, number: int) -> Iterator[Turn]:
    """A day's messages, cut into turns."""
    site, later_ns = corridor.inputs.site.name, number * _DAY_NS
    messages = corridor.messages(seed=number)
    for turn, some in groupby(messages, lambda item: (item[1].stamp_ns - EPOCH_NS) // _TURN_NS):
        came = []
        for node, message in some:
            payload = cdr.encode(replace(message, stamp_ns=message.stamp_ns + later_ns))
            came.append((node, INPUT_TOPICS[type(message)].key(site, node), payload))
        yield EPOCH_NS + later_ns + (turn + 1) * _TURN_NS, came


def _received(source: Connection) -> Iterator[Turn]:
    try:
        while True:
            yield from source.recv()
    except EOFError:
        return
