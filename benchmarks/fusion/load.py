"""What live fusion costs under a load: updates, its thread, its solver, memory and checkpoint.

    python -m benchmarks load [NAME…] [--minutes M]

Robots drive round a ring of cameras and may then stand. Messages are taken as the node takes them,
in turns of 20 ms of the session: decoded, fused, stored where the checkpoint wants them,
corrections encoded, with the solver in its own process. They come as quickly as they are used and
the solver is waited for every 30 s of the session; or by the clock, where nothing waits for it.
What is measured is what comes after the first lap, from which on all cameras are located (the
whole where that is not reached), or the standstill. Times are the processor's.
"""

import time
from collections.abc import Iterator
from pathlib import Path
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
from trigpoint.tools.simulation.session import EPOCH_NS

from .corridor import Corridor

_TURN_NS = to_ns(0.02)
_TELL_S, _MOST_LATE_S = 30.0, 60.0
_POLL_S = 0.05
_MEASURED_LAPS = 0.2


class Load(Struct, frozen=True):
    """A drive; `by_the_clock`: its messages come when they are due."""

    corridor: Corridor
    by_the_clock: bool = False


def _ring(cameras: int, robots: int, pictures_hz: float) -> Load:
    """A lap of cameras that tell of empty pictures too, and a fifth of one that is measured."""
    lap_s = Corridor(cameras, 0.0).lap_s
    seconds = (1 + _MEASURED_LAPS) * lap_s
    return Load(Corridor(cameras, seconds, robots, pictures_hz, 50.0, is_empty_told=True))


LOADS: dict[str, Load] = {
    "short": Load(Corridor(10, 180.0)),
    "hour": Load(Corridor(100, 3600.0)),
    "1-robot": _ring(10, 1, 5.0),
    "3-robots": _ring(10, 3, 5.0),
    "10-robots": _ring(10, 10, 5.0),
    "10-seldom": _ring(10, 10, 0.2),
    "30-cameras": _ring(30, 3, 10.0),
    "crowd": Load(Corridor(30, 330.0, 10, 5.0, 50.0, is_empty_told=True), by_the_clock=True),
    "drives": Load(Corridor(10, 1200.0, odometry_hz=50.0)),
    "day": Load(Corridor(30, 8 * 3600.0, pictures_hz=1.0)),
    "stands": Load(Corridor(10, 262.5, odometry_hz=50.0, stands_s=1800.0)),
}


class Span(Struct):
    """A part of a session: what its turns took, and how late after its messages were due each turn
    with sightings was done; `memory`: MB of the estimator and of its solver, every 30 s."""

    messages: int = 0
    sightings: int = 0
    pictures: int = 0
    kept: int = 0
    spent_s: float = 0.0
    updates_ms: list[float] = field(default_factory=list)
    late_s: list[float] = field(default_factory=list)
    memory: list[tuple[float, float]] = field(default_factory=list)

    def told(self, passed_s: float) -> str:
        """For people; `passed_s`: of the session."""
        late = f" {1e3 * np.median(self.late_s):.0f} ms after due" if self.late_s else ""
        update = f"{np.median(self.updates_ms):.1f} ms" if self.updates_ms else "–"
        return (
            f"{self.sightings / passed_s:.1f} sightings/s, an update {update}{late}; the thread "
            f"{100 * self.spent_s / passed_s:.0f} %"
        )


Turn = list[tuple[str, Input, str, bytes]]
"""Node, message, its type and its payload."""


def run(effort: float = 1.0) -> list[Row]:
    """Two laps of a few cameras; the longer loads are runs of their own."""
    return measured("short", minutes=3 * effort)


def measured(name: str, *, minutes: float | None = None, tells: bool = False) -> list[Row]:
    """A load's rows, from a process of its own, whose memory is then the estimator's."""
    load = LOADS[name]
    if minutes is not None:
        load = replace(load, corridor=replace(load.corridor, duration_s=60 * minutes))
    return in_new_process(_driven, name, load, tells)


def _driven(name: str, load: Load, tells: bool) -> list[Row]:
    return_large_arrays()  # as the command does it
    solver = SolverProcess(load.corridor.inputs.data_set())
    try:
        with TemporaryDirectory() as folder:
            return Drive(load, solver, Path(folder), tells=tells).go(name)
    finally:
        solver.close()


class Drive:
    """Feeds a pipeline, and notes what its turns take. `folder`: of the checkpoint."""

    def __init__(
        self, load: Load, solver: SolverProcess, folder: Path, *, tells: bool = False
    ) -> None:
        self._load, self._solver, self._tells = load, solver, tells
        inputs = load.corridor.inputs
        self._site = inputs.site.name
        self.folder = folder
        self._storage = MapStorage(folder, inputs.site, SystemClock(), knows=lambda _: True)
        self.pipeline = Pipeline(inputs, is_live=False, solver=solver)
        self.pipeline.resumed(is_new=True)
        self._asked_s, self._answer_s = 0.0, float("nan")
        self.begin()

    def go(self, name: str) -> list[Row]:
        """All of it; its rows."""
        from_s, told_s, now_s = self._load.corridor.measured_from_s, 0.0, 0.0
        session = turns(self._load.corridor)
        if self._load.by_the_clock:
            session = iter(list(session))  # made beforehand, which takes about as long
        began_s = time.monotonic()
        for now_ns, turn in session:
            before_s, now_s = now_s, to_seconds(now_ns - EPOCH_NS)
            if before_s < from_s <= now_s:
                self.begin()
            late_s = self._taken_late_s(now_ns, turn, began_s + now_s)
            if now_s - told_s >= _TELL_S or late_s > _MOST_LATE_S:
                self._pause(now_s, now_s - told_s)
                told_s = now_s
            if late_s > _MOST_LATE_S:
                typer.echo("the turns are a minute late: this is not carried", err=True)
                break
        self.close()
        what = f"{name}, min {from_s / 60:.1f} to {now_s / 60:.1f}"
        return list(self._rows(what, now_s - from_s))

    def close(self) -> None:
        """End the checkpoint."""
        self._storage.close()

    def begin(self) -> None:
        """What is measured begins here."""
        self.span, self._lately = Span(memory=[self.memory_mb()]), Span()
        self._solver_s, self._stored = worked_s(self._solver.pid), self.stored_mb()

    def _pause(self, now_s: float, passed_s: float) -> None:
        """Listen to the solver, note the memory, and tell of the time since the last pause."""
        self.listen()
        self.span.memory.append(self.memory_mb())
        if self._tells:
            mine, solvers = self.span.memory[-1]
            answer = f"; last answer {self._answer_s:.0f} s" if self._asked_s else ""
            typer.echo(
                f"{now_s:6.0f} s: {self._lately.told(passed_s)}; {self.pipeline.located_count} "
                f"located; {mine:.0f} + {solvers:.0f} MB, {self.stored_mb():.1f} stored{answer}",
                err=True,
            )
        self._lately = Span()

    def _taken_late_s(self, now_ns: int, turn: Turn, due_s: float) -> float:
        """Take a turn, by the clock not before it is due; how late it was done then."""
        if not self._load.by_the_clock:
            self.take(now_ns, turn)
            return 0.0
        time.sleep(max(0.0, due_s - time.monotonic()))
        self.take(now_ns, turn)
        late_s = time.monotonic() - due_s
        for span in (self.span, self._lately) if _seen(turn) else ():
            span.late_s.append(late_s)
        return late_s

    def take(self, now_ns: int, turn: Turn) -> None:
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
        self._storage.settle(self.pipeline.past)
        seen = _seen(turn)
        for span in (self.span, self._lately):
            span.messages, span.spent_s = span.messages + len(turn), span.spent_s + took_s
            span.sightings += seen
            span.pictures += sum(isinstance(message, Sightings) for _, message, *_ in turn)
            span.kept += sum(isinstance(message, Sightings) for _, message, _ in kept)
            if seen:
                span.updates_ms.append(1e3 * took_s)

    def listen(self) -> None:
        """Ask the solver for everything, and wait for it where nothing comes by the clock."""
        if not self._load.by_the_clock:
            self.pipeline.reports.ask()
            while not self.pipeline.reports.is_answered:
                time.sleep(_POLL_S)
                self.pipeline.advance()
        elif self._asked_s and not self.pipeline.reports.is_answered:
            self._answer_s = time.monotonic() - self._asked_s
        else:
            self.pipeline.reports.ask()
            self._asked_s = time.monotonic()

    def solver_s(self) -> float:
        """What the solver worked since `begin`."""
        return worked_s(self._solver.pid) - self._solver_s

    def _rows(self, what: str, passed_s: float) -> Iterator[Row]:
        span, memory = self.span, [*self.span.memory, self.memory_mb()]
        updates_ms = span.updates_ms or [np.nan]
        seen_1s, full_1s = span.sightings / passed_s, span.sightings / span.spent_s
        solver = self.solver_s() / passed_s
        stored_mb, minutes = self.stored_mb() - self._stored, passed_s / 60
        located, cameras = self.pipeline.located_count, self._load.corridor.cameras
        goal = (20.0, "the goal of 99 % at 100 cameras")
        told = [
            ("an update, 50 %", "ms", np.percentile(updates_ms, 50), *goal),
            ("an update, 99 %", "ms", np.percentile(updates_ms, 99), *goal),
            (f"longest of {len(span.updates_ms)}", "ms", max(updates_ms), *goal),
            ("messages", "1/s", span.messages / passed_s, seen_1s, "seen"),
            ("the thread", "cores", span.spent_s / passed_s, 1.0, "one core"),
            ("the solver", "cores", solver, 1.0, "one core"),
            ("sightings that fill the thread", "1/s", full_1s, seen_1s, "seen"),
            ("resident, estimator", "MB", memory[-1][0], memory[0][0], "at the begin"),
            ("resident, solver", "MB", memory[-1][1], memory[0][1], "at the begin"),
            ("checkpoint, added", "MB", stored_mb, minutes, "minutes"),
            ("pictures kept", "pictures", span.kept, span.pictures, "all that came"),
            ("located", "cameras", located, cameras, "all"),
        ]
        for share in (50, 99) if span.late_s else ():
            late_ms = 1e3 * np.percentile(span.late_s, share)
            told.append((f"done after due, {share} %", "ms", late_ms, 20.0, "a turn"))
        for text, unit, ours, other, against in told:
            yield Row("load", f"{what}: {text}", unit, float(ours), float(other), against)

    def memory_mb(self) -> tuple[float, float]:
        """Resident: the estimator's and its solver's."""
        return resident_mb("self"), resident_mb(self._solver.pid)

    def stored_mb(self) -> float:
        """Of all files of the map."""
        return sum(path.stat().st_size for path in self.folder.glob("*.bin")) / 1e6


def turns(corridor: Corridor, *, seed: int = 0, later_ns: int = 0) -> Iterator[tuple[int, Turn]]:
    """The session, `later_ns` after its own time, cut into turns: until when, and what came."""
    until_ns, turn = EPOCH_NS + later_ns + _TURN_NS, Turn()
    for node, drawn in corridor.messages(seed=seed):
        message = replace(drawn, stamp_ns=drawn.stamp_ns + later_ns) if later_ns else drawn
        while message.stamp_ns >= until_ns:
            yield until_ns, turn
            until_ns, turn = until_ns + _TURN_NS, Turn()
        topic = INPUT_TOPICS[type(message)]
        turn.append((node, message, topic.type_name, cdr.encode(message)))


def _seen(turn: Turn) -> int:
    return sum(isinstance(message, Sightings) and bool(message.faces) for _, message, *_ in turn)


def main(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[NAME]…", help=f"Of {', '.join(LOADS)}.")
    ] = None,
    minutes: Annotated[float | None, typer.Option(help="Of driving, if others.")] = None,
) -> list[Row]:
    """Drive round a corridor, and say what it costs."""
    if unknown := [name for name in names or [] if name not in LOADS]:
        raise typer.BadParameter(f"no load «{unknown[0]}»; choose of {', '.join(LOADS)}")
    chosen = names or ["short"]
    return [row for name in chosen for row in measured(name, minutes=minutes, tells=True)]
