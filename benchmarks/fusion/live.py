"""What live work costs where many cameras are: each update, and memory.

`python -m benchmarks.fusion.live [--cameras N] [--seconds N] [--resumed N]` drives round the
corridor for so long. From the second lap on all cameras are located, so that every sighting is
worked out. The first `--resumed` seconds are taken as a checkpoint is, after which fusion goes on
live: the end of a long session without the time that the whole of it takes.
"""

import os
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from benchmarks.machine import machine
from benchmarks.table import Row, formatted
from trigpoint.base.clock import to_ns, to_seconds
from trigpoint.contract import cdr
from trigpoint.contract.messages import Odometry, Sightings
from trigpoint.fusion.live.memory import return_large_arrays
from trigpoint.fusion.live.solver_process import SolverProcess
from trigpoint.fusion.pipeline import Pipeline

from .corridor import EPOCH_NS, Corridor

_NAME = "live"
_SHORT = Corridor(cameras=10, duration_s=180.0)
# So far the session runs ahead of its solver at most, and how often the estimator then looks.
_LEAD_S = 30.0
_TURN_S = 0.05


def run(effort: float = 1.0) -> list[Row]:
    """Two laps of a few cameras; the whole hour of a hundred is a run of its own (see above)."""
    return measured(Corridor(_SHORT.cameras, _SHORT.duration_s * effort)).rows


@dataclass(frozen=True, slots=True)
class Memory:
    """Resident, MB, of the estimator's process and of its solver's."""

    mine: float
    solvers: float

    @property
    def together(self) -> float:
        return self.mine + self.solvers


@dataclass(frozen=True, slots=True)
class Live:
    """What a session cost.

    `from_s`: where it was live from; `updates`: (n, 2): the session's second of each turn with a
    sighting, and the processor's milliseconds that it took; `memory`: the session's second, and
    what was resident then; `most`: at most; `solver_share`: of a core, at the session's pace.
    """

    corridor: Corridor
    from_s: float
    updates: np.ndarray
    memory: list[tuple[float, Memory]]
    most: Memory
    solver_share: float

    @property
    def growth(self) -> float:
        """MB an hour of both processes together, a line through what the rows are about."""
        seconds = np.array([at_s for at_s, _ in self.memory])
        together = np.array([memory.together for _, memory in self.memory])
        later = seconds >= self._from_s
        if later.sum() < 2:
            return float("nan")
        return float(3600 * np.polyfit(seconds[later], together[later], 1)[0])

    @property
    def _from_s(self) -> float:
        """What the rows are about: live, and the second lap where it is reached."""
        lap_s = self.corridor.lap_s
        return max(self.from_s, lap_s if lap_s < self.corridor.duration_s else 0.0)

    @property
    def rows(self) -> list[Row]:
        """As the table has them."""
        corridor, took = self.corridor, self.updates[self.updates[:, 0] >= self._from_s, 1]
        middle, most = np.percentile(took, [50, 99]).tolist()
        first, last = self._from_s / 60, corridor.duration_s / 60
        what = f"{corridor.cameras} cameras, min {first:.0f} to {last:.0f}"
        goal = "the goal of 99 % at 100"
        return [
            Row(_NAME, f"{what}: an update, 50 %", "ms", middle, 20.0, goal),
            Row(_NAME, f"{what}: an update, 99 %", "ms", most, 20.0, goal),
            Row(_NAME, f"{what}: the longest of {len(took)}", "ms", took.max(), 20.0, goal),
            Row(_NAME, f"{what}: resident, estimator", "MB", self.most.mine, 500.0, "the goal"),
            Row(_NAME, f"{what}: resident, solver", "MB", self.most.solvers, 500.0, "the goal"),
            Row(_NAME, f"{what}: both, growth", "MB/h", self.growth, 500.0, "the goal in all"),
            Row(_NAME, f"{what}: the solver", "cores", self.solver_share, 1.0, "one core"),
        ]


def measured(corridor: Corridor, *, resumed_s: float = 0.0, tells: bool = False) -> Live:
    """Drive along a corridor with a solver beside, as the node does it, in a process of its own,
    whose memory is then the live estimator's. `resumed_s`: so much of it comes from a checkpoint;
    `tells`: how far it is, every 30 s of the session.
    """
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(_driven, corridor, resumed_s, tells).result()


def _driven(corridor: Corridor, resumed_s: float, tells: bool) -> Live:
    return_large_arrays()  # as the command does it
    solver = SolverProcess(corridor.inputs.data_set())
    try:
        drive = _Drive(corridor, solver, tells=tells)
        began_s = drive.go(resumed_s)
        most = Memory(_resident_mb("self", "VmHWM"), _resident_mb(solver.pid, "VmHWM"))
        share = (worked_s(solver.pid) - began_s) / (corridor.duration_s - resumed_s)
    finally:
        solver.close()
    return Live(corridor, resumed_s, np.array(drive.updates), drive.memory, most, share)


class _Drive:
    """Feeds a pipeline, and notes what its turns take.

    Messages come as quickly as they are used, since an hour would take an hour; so that the solver
    has its time all the same, it is waited for after every so many seconds of the session.
    """

    def __init__(self, corridor: Corridor, solver: SolverProcess, *, tells: bool) -> None:
        self._messages = corridor.messages()
        self._solver, self._tells = solver, tells
        self._pipeline = Pipeline(corridor.inputs, is_live=False, solver=solver)
        self.updates: list[tuple[float, float]] = []
        self.memory: list[tuple[float, Memory]] = []

    def go(self, resumed_s: float) -> float:
        """All of it; how long the solver had worked when it went on live, seconds."""
        self._resume(resumed_s)
        began_s = worked_s(self._solver.pid)
        has_sightings, waited_s, pushes_s = False, resumed_s, 0.0
        for node, message in self._messages:
            began = time.thread_time()
            self._pipeline.push(node, message)
            has_sightings |= isinstance(message, Sightings)
            if not isinstance(message, Odometry):
                pushes_s += time.thread_time() - began
                continue
            for output in self._pipeline.advance(message.stamp_ns):
                cdr.encode(output.message)
            now_s = to_seconds(message.stamp_ns - EPOCH_NS)
            if has_sightings:
                took_s = pushes_s + time.thread_time() - began
                self.updates.append((now_s, 1e3 * took_s))
            has_sightings, pushes_s = False, 0.0
            if now_s - waited_s >= _LEAD_S:
                waited_s = now_s
                self._pipeline.reports.ask()
                self._wait()
                self._note(now_s)
        return began_s

    def _resume(self, resumed_s: float) -> None:
        """Take what came before as the node takes a checkpoint."""
        if not resumed_s:
            self._pipeline.resumed(is_new=True)
            return
        for node, message in self._messages:
            self._pipeline.push(node, message)
            if isinstance(message, Odometry):
                self._pipeline.advance()
                if message.stamp_ns - EPOCH_NS >= to_ns(resumed_s):
                    break
        self._pipeline.resumed()
        self._wait()

    def _wait(self) -> None:
        """Until the solver has done everything that it was told."""
        while not self._pipeline.reports.is_answered:
            time.sleep(_TURN_S)
            self._pipeline.advance()

    def _note(self, now_s: float) -> None:
        memory = Memory(_resident_mb("self", "VmRSS"), _resident_mb(self._solver.pid, "VmRSS"))
        self.memory.append((now_s, memory))
        if self._tells:
            lately = [took for at_s, took in self.updates if at_s > now_s - _LEAD_S]
            typer.echo(
                f"{now_s:6.0f} s: {self._pipeline.located_count} cameras located, an update "
                f"{np.median(lately):.1f} ms, {max(lately):.1f} at most; resident "
                f"{memory.mine:.0f} + {memory.solvers:.0f} MB",
                err=True,
            )


def _resident_mb(process: int | str, what: str) -> float:
    """Memory of a process by its status: VmRSS now, VmHWM at most."""
    for line in Path(f"/proc/{process}/status").read_text().splitlines():
        if line.startswith(f"{what}:"):
            return int(line.split()[1]) / 1024
    raise KeyError(what)


def worked_s(process: int) -> float:
    """The processor's time of a process."""
    ticks = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[11:13]
    return sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK")


def main(
    cameras: Annotated[int, typer.Option(help="On the ring.", min=2)] = 100,
    seconds: Annotated[float, typer.Option(help="Of the session.", min=60.0)] = 3600.0,
    resumed: Annotated[float, typer.Option(help="So many of them from a checkpoint.")] = 0.0,
) -> None:
    """Drive round a corridor, and say what the updates and memory come to."""
    before = machine()
    live = measured(Corridor(cameras, seconds), resumed_s=resumed, tells=True)
    typer.echo("\n".join(formatted(live.rows)))
    typer.echo(f"{before.summary}; {machine().load:.1f} at the end")


if __name__ == "__main__":
    typer.run(main)
