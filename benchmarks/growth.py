"""How fusion's memory and checkpoint grow: with a robot that drives, and with one that stands.

`python -m benchmarks.growth [--drives MINUTES] [--stands MINUTES]` drives round a ring of ten
cameras, then stands before the last one. The estimator and its solver are measured one after the
other, each in a process of its own: memory after what is free was given back to the system.
"""

import argparse
import ctypes
import gc
import os
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from trigpoint import cdr, topics
from trigpoint.clock import to_ns
from trigpoint.fusion.live.memory import return_large_arrays
from trigpoint.fusion.live.solver_messages import Finish, News, Order
from trigpoint.fusion.live.solver_worker import SolverWorker
from trigpoint.fusion.pipeline import Pipeline
from trigpoint.fusion.standing_odometry import StandingOdometry
from trigpoint.messages import CameraInfo, Message, Odometry, Sightings

from .corridor import EPOCH_NS, Corridor
from .machine import machine

_ODOMETRY_HZ, _PICTURES_HZ = 50.0, 5.0
_NOISE_PX = 0.1
# The solver is asked for everything this often.
_ASKED_NS = to_ns(30.0)
_TYPES = {CameraInfo: topics.CAMERA_INFO, Odometry: topics.ODOMETRY, Sightings: topics.SIGHTINGS}
_HEAD = 30  # bytes of a record beside key and payload


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
        self.told: list[Order] = []

    def tell(self, orders: Sequence[Order]) -> None:
        self.told += orders

    def news(self) -> list[News]:
        return []

    def close(self) -> None:
        pass


def measured(corridor: Corridor, stands_s: float, *, solves: bool) -> list[Growth]:
    """The drive's growth and the standstill's: of the solver, or of all the rest."""
    return_large_arrays()
    inputs, orders = corridor.inputs, _Orders()
    pipeline = Pipeline(inputs, solver=orders)
    worker = SolverWorker(inputs.data_set(), time.perf_counter) if solves else None
    odometry = StandingOdometry()
    found, last, asked_ns = [], {}, EPOCH_NS
    phases = (corridor.messages(), _standing(last, stands_s, corridor))
    for phase, seconds in zip(phases, (corridor.duration_s, stands_s), strict=True):
        before, pictures, kept, size = _memory_mb(), 0, 0, 0
        for node, message in phase:
            assert isinstance(message, CameraInfo | Odometry | Sightings)
            last[type(message)] = node, message
            is_kept = pipeline.push(node, message)
            pipeline.advance(message.stamp_ns)
            pictures += isinstance(message, Sightings)
            kept += isinstance(message, Sightings) and is_kept
            size += _stored(node, message, odometry) if is_kept else 0
            told, orders.told = orders.told, []
            if worker is not None:
                if message.stamp_ns - asked_ns > _ASKED_NS:
                    told, asked_ns = [*told, Finish()], message.stamp_ns
                for order in told:
                    for _ in worker.carry_out(order):
                        pass
        grown = _memory_mb() - before
        found.append(Growth(seconds / 60, pictures, kept, grown, size / 1e6))
    return found


def _standing(
    last: dict[type, tuple[str, Message]], seconds: float, corridor: Corridor
) -> Iterator[tuple[str, Message]]:
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


def _stored(node: str, message: Message, odometry: StandingOdometry) -> int:
    """Bytes that a message takes in the checkpoint."""
    topic = _TYPES[type(message)]
    payload, head = cdr.encode(message), _HEAD + len(topic.key("corridor", node))
    if not isinstance(message, Odometry):
        return head + len(payload)
    return sum(head + len(item) for item in odometry.take(message, payload))


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
