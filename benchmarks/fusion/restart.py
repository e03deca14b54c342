"""Fusion that is started again: until it has read its checkpoint, until it corrects, and until its
solver has answered.

    python -m benchmarks restart [--minutes M]

A robot drives round thirty cameras, with odometry at 20 Hz and 0.7 sightings a second, and what
came lies in a checkpoint. A node goes on from it twice, with its solver in its own process: first
without, then with the solution that the first one left. Times are the clock's; reading is the
processor's too, of a process of its own.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer
from support.builders import eventually

from benchmarks.table import Row
from benchmarks.timing import in_new_process
from trigpoint.base.clock import ManualClock, SystemClock, to_seconds
from trigpoint.bus.bus import Bus
from trigpoint.contract import cdr
from trigpoint.contract.topics import command_key
from trigpoint.fusion.checkpoint import CHECKPOINT, full_files, read_checkpoint
from trigpoint.fusion.inbox import INPUT_TOPICS
from trigpoint.fusion.live.solver_process import SolverProcess
from trigpoint.fusion.map_storage import MapStorage
from trigpoint.fusion.model.inputs import Inputs
from trigpoint.fusion.node import FusionNode
from trigpoint.node.node import Node
from trigpoint.testing.memory_bus import MemoryBroker
from trigpoint.tools.simulation.session import EPOCH_NS

from .corridor import Corridor

_CAMERAS = 30
_ANSWER_S, _PATIENCE_S = 60.0, 900.0


def main(
    minutes: Annotated[float, typer.Option(help="Of driving: 33 are some 41,000 messages.")] = 33.5,
) -> list[Row]:
    """Start fusion again on a checkpoint, without and with its last solution."""
    corridor = Corridor(_CAMERAS, 60 * minutes, pictures_hz=1.0)
    with TemporaryDirectory() as folder:
        return list(_rows(corridor, Path(folder)))


def _rows(corridor: Corridor, folder: Path) -> Iterator[Row]:
    count = _stored(corridor, folder)
    for what in ("without a solution", "with one"):
        work, read, corrects, solved = in_new_process(_started, corridor, folder)
        name = f"{count} messages, {what}"
        goals = {"work until read": work, "read": read, "cameras known again": corrects}
        for stage, seconds in goals.items():
            yield Row("restart", f"{name}: {stage}", "s", seconds, 5.0, "the goal")
        yield Row("restart", f"{name}: solved", "s", solved, corrects, "known again")


def _stored(corridor: Corridor, folder: Path) -> int:
    """Store a drive's messages; how many."""
    site = corridor.inputs.site
    clock = ManualClock()
    storage = MapStorage(folder, site, clock, knows=lambda _: True)
    for node, message in corridor.messages():
        key = INPUT_TOPICS[type(message)].key(site.name, node)
        storage.store(key, cdr.encode(message), message)
        clock.advance(max(0.0, to_seconds(message.stamp_ns - EPOCH_NS - clock.elapsed_ns())))
        storage.flush()
    storage.close()
    files = [*full_files(folder), folder / CHECKPOINT]
    return sum(1 for path in files for _ in read_checkpoint(path))


@contextmanager
def _fusion(corridor: Corridor, folder: Path) -> Iterator[tuple[FusionNode, Node, Bus]]:
    """A node on a checkpoint that may be started, and another session of its bus; it is stopped
    and finished at the end."""
    inputs, broker = corridor.inputs, MemoryBroker()
    with (
        broker.session() as bus,
        broker.session() as other,
        Node(bus, site=inputs.site.name, kind="fusion", name="fusion") as node,
    ):
        fusion = FusionNode(bus, node, inputs, folder, SystemClock(), solver=_solver)
        yield fusion, node, other
    fusion.finish()


def _solver(inputs: Inputs) -> SolverProcess:
    return SolverProcess(inputs.data_set())


def read_s(corridor: Corridor, folder: Path) -> float:
    """The work of a node that is started on a checkpoint until it has read it, s; it solves
    nothing, and leaves nothing but what it would write at a stop."""
    with _fusion(corridor, folder) as (fusion, _, _):
        began_s = time.process_time()
        fusion.start()
        _wait(lambda: fusion.is_resumed)
        return time.process_time() - began_s


def _started(corridor: Corridor, folder: Path) -> tuple[float, float, float, float]:
    """Start a node on a checkpoint and stop it once all is solved: work until it was read, s, and
    after how long it was read, its cameras were known and its solver had answered, s."""
    with _fusion(corridor, folder) as (fusion, node, other):
        began_s, worked_s = time.monotonic(), time.process_time()
        fusion.start()
        _wait(lambda: fusion.is_resumed)
        work_s, read_s = time.process_time() - worked_s, time.monotonic() - began_s
        _wait(lambda: node.health.report().values["cameras_located"] != "0")
        corrects_s = time.monotonic() - began_s
        asked = command_key(corridor.inputs.site.name, "fusion/network")
        _wait(lambda: not any(reply.error for reply in other.query(asked, timeout_s=_ANSWER_S)))
        return work_s, read_s, corrects_s, time.monotonic() - began_s


def _wait(holds: Callable[[], bool]) -> None:
    if not eventually(holds, _PATIENCE_S):
        raise TimeoutError(f"fusion was not so far after {_PATIENCE_S:.0f} s")
