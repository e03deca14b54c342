"""What live fusion costs under a load: updates, its thread, its solver, memory and checkpoint; and
what of that grows with the age of a map.

    python -m benchmarks load [NAME…] [--minutes M] [--days D]

Robots drive round a ring of cameras and may then stand. Messages are taken as the node takes them,
in turns of 20 ms of the session: decoded, fused, stored where the checkpoint wants them,
corrections encoded, with the solver in its own process. They come as quickly as they are used and
the solver is waited for every 30 s of the session. What is measured is what comes after the first
lap, from which on all cameras are located (the whole where that is not reached), or the standstill.
Times are the processor's.

In `month` a robot is switched on each day at the same place, its odometry anew; at night nothing
comes. Memory and checkpoint are then the most of a day (of the estimator's, some 60 MB are eight
hours' drawn poses), a solution is the solver's time of the day by the number of its solutions, a
start a node's work until it has read the checkpoint of the day's end, and an error that of the
cameras' positions; of its squares by their covariances, a number, 1 is to be expected.
"""

import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from shutil import copytree
from tempfile import TemporaryDirectory
from typing import Annotated

import numpy as np
import typer
from msgspec import Struct, field
from msgspec.structs import replace

from benchmarks.table import Row
from benchmarks.timing import in_new_process, resident_mb, worked_s
from trigpoint.base.clock import SystemClock, to_ns, to_seconds
from trigpoint.contract import cdr
from trigpoint.contract.messages import Sightings
from trigpoint.fusion.inbox import INPUT_TOPICS, Input
from trigpoint.fusion.live.memory import return_large_arrays
from trigpoint.fusion.live.solver_process import SolverProcess
from trigpoint.fusion.map_storage import MapStorage
from trigpoint.fusion.pipeline import Pipeline
from trigpoint.map.network import PoseRecord
from trigpoint.tools.networks.truth import TruthFile, network_error
from trigpoint.tools.simulation.session import EPOCH_NS

from .corridor import DAY_NS, Corridor
from .restart import read_s

_TURN_NS = to_ns(0.02)
_TELL_S = 30.0
_POLL_S = 0.05
_MEASURED_LAPS = 0.2


def _ring(cameras: int, robots: int, pictures_hz: float) -> Corridor:
    """A lap of cameras that tell of empty pictures too, and a fifth of one that is measured."""
    lap_s = Corridor(cameras, 0.0).lap_s
    seconds = (1 + _MEASURED_LAPS) * lap_s
    return Corridor(cameras, seconds, robots, pictures_hz, 50.0, is_empty_told=True)


LOADS: dict[str, Corridor] = {
    "short": Corridor(10, 180.0),
    "hour": Corridor(100, 3600.0),
    "1-robot": _ring(10, 1, 5.0),
    "3-robots": _ring(10, 3, 5.0),
    "10-robots": _ring(10, 10, 5.0),
    "10-seldom": _ring(10, 10, 0.2),
    "drives": Corridor(10, 1200.0, odometry_hz=50.0),
    "day": Corridor(30, 8 * 3600.0, pictures_hz=1.0),
    "month": Corridor(30, 8 * 3600.0, pictures_hz=20.0 / 14),  # of which 0.7 see the robot
    "stands": Corridor(10, 262.5, odometry_hz=50.0, stands_s=1800.0),
}
_DAYS = {"month": 30}
Turn = list[tuple[str, Input, str, bytes]]
"""Node, message, its type and its payload."""


class Span(Struct):
    """A part of a session: what came, what its turns and the solver took, and in MB, every 30 s,
    the `memory` of the estimator and of its solver, and the checkpoint."""

    messages: int = 0
    sightings: int = 0
    pictures: int = 0
    kept: int = 0
    pasts: int = 0
    solutions: int = 0
    spent_s: float = 0.0
    solver_s: float = 0.0
    updates_ms: list[float] = field(default_factory=list)
    memory: list[tuple[float, float, float]] = field(default_factory=list)

    def __str__(self) -> str:
        update = f"{np.median(self.updates_ms):.1f} ms" if self.updates_ms else "–"
        mine, solvers, stored = np.max(self.memory, axis=0)
        return (
            f"{self.sightings} sightings, an update {update}; the thread {self.spent_s:.1f} s; "
            f"{self.solutions} solutions, {self.solver_s:.1f} s; {mine:.0f} + {solvers:.0f} MB, "
            f"{stored:.1f} stored; {self.pasts} summaries"
        )


class Day(Struct, frozen=True):
    """A day, and what its end came to: a start from its checkpoint, s, and the located cameras'
    error of position, mm, and mean of its squares by covariance and number."""

    span: Span
    start_s: float
    error_mm: float
    squared: float

    def __str__(self) -> str:
        return (
            f"{self.span}; a start {self.start_s:.1f} s; off by {self.error_mm:.1f} mm, squares by "
            f"covariance {self.squared:.2f}"
        )


def run(effort: float = 1.0) -> list[Row]:
    """Two laps of a few cameras; the longer loads are runs of their own."""
    return in_new_process(_driven, "short", replace(LOADS["short"], duration_s=180 * effort), 1)


def _driven(name: str, corridor: Corridor, days: int) -> list[Row]:
    """A load's rows, from a process of its own, whose memory is then the estimator's."""
    return_large_arrays()  # as the command does it
    solutions = list[float]()
    solver = SolverProcess(corridor.inputs.data_set(), took=solutions.append)
    with closing(solver), TemporaryDirectory() as folder:
        drive = Drive(corridor, solver, Path(folder), solutions)
        with closing(drive):
            if days == 1:
                drive.go(turns(corridor), from_s=corridor.measured_from_s, tells=True)
                return list(drive.rows(name))
            return _daily_rows(name, [drive.day(number) for number in range(days)])


class Drive:
    """Feeds a pipeline, and notes what its turns take; `solutions`: what each took."""

    def __init__(
        self, corridor: Corridor, solver: SolverProcess, folder: Path, solutions: list[float]
    ) -> None:
        self._corridor, self._solver, self._folder = corridor, solver, folder
        self._solutions = solutions
        inputs = corridor.inputs
        self._site = inputs.site.name
        self._storage = MapStorage(folder, inputs.site, SystemClock(), knows=lambda _: True)
        self.pipeline = Pipeline(inputs, is_live=False, solver=solver)
        self.pipeline.resumed(is_new=True)
        self._past = self.pipeline.past
        self._now_s = self._from_s = 0.0
        self.span = self._begun()
        self._lately = self._begun()

    def go(
        self, session: Iterator[tuple[int, Turn]], *, from_s: float = 0.0, tells: bool = False
    ) -> None:
        """All of a session, or of a day, of which the span is what comes after `from_s`."""
        told_s = 0.0 if tells else -np.inf
        for now_ns, turn in session:
            before_s, self._now_s = self._now_s, to_seconds(now_ns - EPOCH_NS)
            if before_s < from_s <= self._now_s:
                self.span, self._from_s = self._begun(), from_s
            self._take(now_ns, turn)
            if self._now_s - told_s >= _TELL_S:
                self._pause(tells=tells)
                told_s = self._now_s

    def day(self, number: int) -> Day:
        """Another day."""
        self.span = self._begun()
        self.go(turns(self._corridor, seed=number, later_ns=number * DAY_NS))
        self._end(self.span)
        with TemporaryDirectory() as other:
            copied = copytree(self._folder, Path(other) / "map")
            start_s = in_new_process(read_s, self._corridor, copied)
        day = Day(self.span, start_s, *self._errors())
        typer.echo(f"day {number + 1}: {day}; {self.pipeline.located_count} located", err=True)
        return day

    def close(self) -> None:
        """End the checkpoint."""
        self._storage.close()

    def _begun(self) -> Span:
        """A part that begins now."""
        at = -worked_s(self._solver.pid)
        return Span(memory=[self._sizes_mb()], solver_s=at, solutions=-len(self._solutions))

    def _end(self, span: Span) -> None:
        span.solver_s += worked_s(self._solver.pid)
        span.solutions += len(self._solutions)

    def _pause(self, *, tells: bool) -> None:
        """Wait until the solver has done everything, and note sizes; tell of the last part."""
        self.pipeline.reports.ask()
        while not self.pipeline.reports.is_answered:
            time.sleep(_POLL_S)
            self.pipeline.advance()
        self.span.memory.append(self._sizes_mb())
        if tells:
            self._lately.memory.append(self._sizes_mb())
            self._end(self._lately)
            located = f"{self.pipeline.located_count} located"
            typer.echo(f"{self._now_s:6.0f} s: {self._lately}; {located}", err=True)
            self._lately = self._begun()

    def _take(self, now_ns: int, turn: Turn) -> None:
        """Take what came until a moment of the session."""
        begin_s, kept = time.thread_time(), list[tuple[str, Input, bytes]]()
        for node, message, type_name, payload in turn:
            if self.pipeline.push(node, cdr.decode(type_name, payload)):
                kept.append((node, message, payload))
        for output in self.pipeline.advance(now_ns):
            cdr.encode(output.message)
        took_s = time.thread_time() - begin_s
        for node, message, payload in kept:
            key = INPUT_TOPICS[type(message)].key(self._site, node)
            self._storage.store(key, payload, message)
        past, self._past = self._past, self.pipeline.past
        self._storage.settle(self._past)
        seen = sum(isinstance(one, Sightings) and bool(one.faces) for _, one, *_ in turn)
        for span in (self.span, self._lately):
            span.messages, span.spent_s = span.messages + len(turn), span.spent_s + took_s
            span.sightings += seen
            span.pasts += self._past is not past
            span.pictures += sum(isinstance(message, Sightings) for _, message, *_ in turn)
            span.kept += sum(isinstance(message, Sightings) for _, message, _ in kept)
            if seen:
                span.updates_ms.append(1e3 * took_s)

    def rows(self, name: str) -> Iterator[Row]:
        """What was measured of a session that is over."""
        self._end(self.span)
        span, passed_s = self.span, self._now_s - self._from_s
        what = f"{name}, min {self._from_s / 60:.1f} to {self._now_s / 60:.1f}"
        updates_ms = span.updates_ms or [np.nan]
        seen_1s, full_1s = span.sightings / passed_s, span.sightings / span.spent_s
        (first_mb, first_solver_mb, first_stored_mb) = span.memory[0]
        (mine_mb, solver_mb, stored_mb) = self._sizes_mb()
        located, cameras = self.pipeline.located_count, self._corridor.cameras
        goal = (20.0, "the goal of 99 % at 100 cameras")
        told = [
            ("an update, 50 %", "ms", np.percentile(updates_ms, 50), *goal),
            ("an update, 99 %", "ms", np.percentile(updates_ms, 99), *goal),
            (f"longest of {len(span.updates_ms)}", "ms", max(updates_ms), *goal),
            ("messages", "1/s", span.messages / passed_s, seen_1s, "seen"),
            ("the thread", "cores", span.spent_s / passed_s, 1.0, "one core"),
            ("the solver", "cores", span.solver_s / passed_s, 1.0, "one core"),
            ("sightings that fill the thread", "1/s", full_1s, seen_1s, "seen"),
            ("resident, estimator", "MB", mine_mb, first_mb, "at the begin"),
            ("resident, solver", "MB", solver_mb, first_solver_mb, "at the begin"),
            ("checkpoint, added", "MB", stored_mb - first_stored_mb, passed_s / 60, "minutes"),
            ("pictures kept", "pictures", span.kept, span.pictures, "all that came"),
            ("located", "cameras", located, cameras, "all"),
        ]
        for text, unit, ours, other, against in told:
            yield Row("load", f"{what}: {text}", unit, float(ours), float(other), against)

    def _sizes_mb(self) -> tuple[float, float, float]:
        """Resident, the estimator's and its solver's; all files of the map."""
        stored = sum(path.stat().st_size for path in self._folder.glob("*.bin")) / 1e6
        return resident_mb("self"), resident_mb(self._solver.pid), stored

    def _errors(self) -> tuple[float, float]:
        """The located cameras' error of position, mm, and its squares by covariance and number."""
        results, own = self.pipeline.results(), self._corridor
        places = {f"c{n}": PoseRecord.of(own.camera(n)) for n in range(own.cameras)}
        found = network_error(results.network, results.covariance, TruthFile(places)).cameras
        squares = [(one.position**2, one.sigmas**2 / 3) for one in found.values()]
        squared, by_covariance = np.mean(squares or [(np.nan, np.nan)], axis=0).tolist()
        return 1e3 * squared**0.5, by_covariance


def _daily_rows(name: str, days: list[Day]) -> list[Row]:
    """The last day beside the second."""
    names = (
        *(("the estimator's memory", "MB"), ("its solver's", "MB"), ("the checkpoint", "MB")),
        *(("a solution", "s"), ("a start", "s"), ("error of a position", "mm")),
        ("squared errors by covariance", "1"),
    )
    second, last = (
        (
            *np.max(day.span.memory, axis=0).tolist(),
            day.span.solver_s / max(day.span.solutions, 1),
            *(day.start_s, day.error_mm, day.squared),
        )
        for day in (days[1], days[-1])
    )
    return [
        Row("load", f"{name}, day {len(days)}, {what}", unit, ours, before, "day 2")
        for (what, unit), ours, before in zip(names, last, second, strict=True)
    ]


def turns(corridor: Corridor, *, seed: int = 0, later_ns: int = 0) -> Iterator[tuple[int, Turn]]:
    """The session, `later_ns` after its own time, cut into turns: until when, and what came."""
    until_ns, turn = EPOCH_NS + later_ns + _TURN_NS, Turn()
    for node, message in corridor.messages(seed=seed, later_ns=later_ns):
        while message.stamp_ns >= until_ns:
            yield until_ns, turn
            until_ns, turn = until_ns + _TURN_NS, Turn()
        topic = INPUT_TOPICS[type(message)]
        turn.append((node, message, topic.type_name, cdr.encode(message)))


def main(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[NAME]…", help=f"Of {', '.join(LOADS)}.")
    ] = None,
    minutes: Annotated[float | None, typer.Option(help="Of driving (a day), if others.")] = None,
    days: Annotated[int | None, typer.Option(help="Of a month, if others.", min=2)] = None,
) -> list[Row]:
    """Drive round a corridor, and say what it costs."""
    if unknown := [name for name in names or [] if name not in LOADS]:
        raise typer.BadParameter(f"no load «{unknown[0]}»; choose of {', '.join(LOADS)}")
    rows = list[Row]()
    for name in names or ["short"]:
        load = LOADS[name]
        load = load if minutes is None else replace(load, duration_s=60 * minutes)
        lasts = (days or _DAYS[name]) if name in _DAYS else 1
        rows += in_new_process(_driven, name, load, lasts)
    return rows
