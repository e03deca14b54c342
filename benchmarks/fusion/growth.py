"""How fusion's memory and checkpoint grow: with a robot that drives, and with one that stands.

`python -m benchmarks.fusion.growth [--drives MINUTES] [--stands MINUTES]` drives round a ring of
ten cameras, then stands before the last one. The estimator and its solver are measured one after
the other, each in a process of its own: memory after what is free was given back to the system.
"""

import argparse
import ctypes
import gc
import os
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.machine import machine
from trigpoint.base.clock import SystemClock, to_ns
from trigpoint.contract import cdr
from trigpoint.contract.messages import Message, Odometry, Sightings
from trigpoint.fusion.inbox import INPUT_TOPICS, Input
from trigpoint.fusion.live.memory import return_large_arrays
from trigpoint.fusion.live.solver_messages import Finish, News, Order
from trigpoint.fusion.live.solver_worker import SolverWorker
from trigpoint.fusion.map_storage import MapStorage
from trigpoint.fusion.pipeline import Inputs, Pipeline

from .corridor import EPOCH_NS, Corridor

_ODOMETRY_HZ, _PICTURES_HZ = 50.0, 5.0
_NOISE_PX = 0.1
# The solver is asked for everything this often.
_ASKED_NS = to_ns(30.0)


@dataclass(frozen=True, slots=True)
class Growth:
    """What a phase added."""

    minutes: float
    pictures: int
    kept: int
    memory_mb: float
    checkpoint_mb: float

    def row(self, who: str, what: str) -> str:
        hours = self.minutes / 60
        return (
            f"| {who}, {what} | {self.minutes:g} min | {self.pictures} | {self.kept} "
            f"| {self.memory_mb:.1f} MB, {self.memory_mb / hours:.0f} an hour "
            f"| {self.checkpoint_mb:.2f} MB, {self.checkpoint_mb / hours:.0f} an hour |"
        )


class _Orders:
    """A solver that only keeps what it is told."""

    def __init__(self) -> None:
        self._told: list[Order] = []

    def tell(self, orders: Sequence[Order]) -> None:
        self._told += orders

    def taken(self) -> list[Order]:
        """What it was told since the last call."""
        told, self._told = self._told, []
        return told

    def news(self) -> list[News]:
        return []

    def close(self) -> None:
        """Nothing is held open."""


class _Run:
    """A live estimator with its checkpoint in a folder; or, if it `solves`, its solver too.

    `last`: the last message of each type, and who sent it.
    """

    def __init__(self, inputs: Inputs, folder: Path, *, solves: bool) -> None:
        self._site, self._orders = inputs.site, _Orders()
        self._pipeline = Pipeline(inputs, solver=self._orders)
        self._worker = SolverWorker(inputs.data_set()) if solves else None
        self._path = folder / "checkpoint.bin"
        self._storage = MapStorage(self._path, inputs.site, SystemClock(), knows=lambda _: True)
        self._asked_ns = EPOCH_NS
        self.last: dict[type[Message], tuple[str, Message]] = {}

    def phase(self, messages: Iterable[tuple[str, Input]], seconds: float) -> Growth:
        """Take messages, and say what they added."""
        memory_mb, stored_mb, pictures, kept = _memory_mb(), self._stored_mb(), 0, 0
        for node, message in messages:
            self.last[type(message)] = node, message
            is_kept = self._take(node, message)
            self._solve(message.stamp_ns)
            pictures += isinstance(message, Sightings)
            kept += isinstance(message, Sightings) and is_kept
        grown = _memory_mb() - memory_mb
        return Growth(seconds / 60, pictures, kept, grown, self._stored_mb() - stored_mb)

    def close(self) -> None:
        self._storage.close()

    def _take(self, node: str, message: Input) -> bool:
        is_kept = self._pipeline.push(node, message)
        self._pipeline.advance(message.stamp_ns)
        if is_kept:
            key = INPUT_TOPICS[type(message)].key(self._site.name, node)
            self._storage.store(key, cdr.encode(message), message)
        return is_kept

    def _solve(self, stamp_ns: int) -> None:
        orders = self._orders.taken()
        if self._worker is None:
            return
        if stamp_ns - self._asked_ns > _ASKED_NS:
            self._asked_ns = stamp_ns
            orders.append(Finish())
        for order in orders:
            for _ in self._worker.carry_out(order):
                pass

    def _stored_mb(self) -> float:
        return self._path.stat().st_size / 1e6


def measured(corridor: Corridor, stands_s: float, *, solves: bool) -> list[Growth]:
    """The drive's growth and the standstill's."""
    return_large_arrays()
    with (
        TemporaryDirectory() as folder,
        closing(_Run(corridor.inputs, Path(folder), solves=solves)) as run,
    ):
        drives = run.phase(corridor.messages(), corridor.duration_s)
        return [drives, run.phase(_standing(run.last, stands_s, corridor), stands_s)]


def _standing(
    last: dict[type[Message], tuple[str, Message]], seconds: float, corridor: Corridor
) -> Iterator[tuple[str, Input]]:
    """The robot standing where it arrived, before the camera that saw it last."""
    (robot, here), (camera, seen) = last[Odometry], last[Sightings]
    assert isinstance(here, Odometry)
    assert isinstance(seen, Sightings)
    random = np.random.default_rng(1)
    every = round(corridor.odometry_hz / corridor.pictures_hz)
    for step in range(1, round(seconds * corridor.odometry_hz)):
        stamp_ns = here.stamp_ns + round(step * 1e9 / corridor.odometry_hz)
        yield robot, replace(here, stamp_ns=stamp_ns)
        if step % every == 0:
            faces = tuple(
                replace(f, pixels=f.pixels + random.normal(0.0, _NOISE_PX, f.pixels.shape))
                for f in seen.faces
            )
            yield camera, replace(seen, stamp_ns=stamp_ns, faces=faces)


def _memory_mb() -> float:
    gc.collect()
    libc = ctypes.CDLL(None)
    if hasattr(libc, "malloc_trim"):
        libc.malloc_trim(0)
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def main() -> None:
    """Drive, stand, and print the table."""
    parser = argparse.ArgumentParser(description="How fusion's memory and checkpoint grow.")
    parser.add_argument("--drives", type=float, default=10.0, help="minutes")
    parser.add_argument("--stands", type=float, default=60.0, help="minutes")
    given = parser.parse_args()
    corridor = Corridor(10, 60 * given.drives, pictures_hz=_PICTURES_HZ, odometry_hz=_ODOMETRY_HZ)
    print(machine().summary)
    print("| what | for | pictures | kept | memory | checkpoint |")
    print("| --- | --- | --- | --- | --- | --- |")
    context = get_context("spawn")
    for solves, who in ((False, "estimator"), (True, "solver")):
        with ProcessPoolExecutor(1, mp_context=context) as pool:
            run = pool.submit(measured, corridor, 60 * given.stands, solves=solves).result()
        for growth, what in zip(run, ("drives", "stands"), strict=True):
            print(growth.row(who, what), flush=True)


if __name__ == "__main__":
    main()
