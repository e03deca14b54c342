"""From put in one process to another's callback, and to whoever takes it there.

Our callback only appends to a queue, from which a thread takes; so does, for comparison, a bare one
with Python's own queue. A second process sends on both by turns (`bus_sender`), on loopback; the
clock is the system's monotonic one, which all processes of a machine share.
"""

import queue
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import zenoh

from benchmarks.table import Row, share_of
from trigpoint.bus.bus import Subscription
from trigpoint.bus.settings import Settings
from trigpoint.contract import topics
from trigpoint.contract.topics import Topic
from trigpoint.zenoh import ZenohBus, open_session

from .bus_wire import WARM_UP, Wire, free_endpoint, open_bare, sent_ns

_LAST_S = 0.5


@dataclass(frozen=True, slots=True)
class Load:
    """`count` payloads of `size` bytes on a topic, each `pause_s` after the one before."""

    what: str
    topic: Topic
    size: int
    count: int
    pause_s: float


def run(effort: float = 1.0) -> list[Row]:
    """Delays of small messages that may not be lost, and of pictures; milliseconds."""
    loads = (
        Load("odometry, 720 B", topics.ODOMETRY, 720, share_of(1000, effort, least=10), 0.002),
        Load("picture, 100 kB", topics.IMAGE, 100_000, share_of(400, effort, least=10), 0.005),
    )
    return [row for load in loads for row in _rows(load)]


def _rows(load: Load) -> list[Row]:
    delays = delays_ms(load)
    return [
        Row(
            "bus",
            f"put to {what}, {load.what}, p{percent}",
            "ms",
            float(np.percentile(ours, percent)),
            float(np.percentile(bare, percent)),
            against,
        )
        for what, ours, bare, against in (
            ("callback", delays.called, delays.bare_called, "zenoh's callback"),
            ("taken", delays.taken, delays.bare_taken, "zenoh's callback and a queue"),
        )
        for percent in (50, 99)
    ]


@dataclass(frozen=True, slots=True)
class Delays:
    """Milliseconds from put to callback, and to whoever takes it, of each message."""

    called: list[float]
    taken: list[float]
    bare_called: list[float]
    bare_taken: list[float]


def delays_ms(load: Load) -> Delays:
    """Through ours and through bare Zenoh, warming up left out."""
    wire = Wire(
        free_endpoint(), free_endpoint(), load.topic.name, load.size, load.count, load.pause_s
    )
    called, waiting = list[float](), queue.SimpleQueue[bytes]()

    def receive(sample: zenoh.Sample) -> None:
        payload = sample.payload.to_bytes()
        called.append(_age_ms(payload))
        waiting.put(payload)

    with (
        ZenohBus(open_session(Settings("peer", listen=(wire.ours,)))) as bus,
        open_bare(listen=wire.bare) as session,
        session.declare_subscriber(wire.bare_key, receive),
        ThreadPoolExecutor(2) as threads,
    ):
        subscription = bus.subscribe(load.topic, wire.our_key)
        with subprocess.Popen(
            [sys.executable, "-m", "benchmarks.network.bus_sender", *wire.arguments]
        ) as sender:
            try:
                ours = threads.submit(_taken, subscription, sender)
                bare = threads.submit(_bare_taken, waiting, sender)
                ages, bare_ages = ours.result(), bare.result()
            finally:
                sender.kill()
        if sender.returncode != 0:
            raise RuntimeError(f"the sender failed with status {sender.returncode}")
    our_called, our_taken = (list(each)[WARM_UP:] for each in zip(*ages, strict=True))
    return Delays(our_called, our_taken, called[WARM_UP:], bare_ages[WARM_UP:])


def _taken(
    subscription: Subscription, sender: subprocess.Popen[bytes]
) -> list[tuple[float, float]]:
    """Take until the sender has ended and nothing comes any more: age at our callback, and now."""
    ages_ms: list[tuple[float, float]] = []
    while True:
        sample = subscription.take(_LAST_S)
        if sample is not None:
            age_ms, since_ms = _age_ms(sample.payload), (time.time_ns() - sample.received_ns) / 1e6
            ages_ms.append((age_ms - since_ms, age_ms))
        elif sender.poll() is not None:
            return ages_ms


def _bare_taken(
    waiting: "queue.SimpleQueue[bytes]", sender: subprocess.Popen[bytes]
) -> list[float]:
    ages_ms: list[float] = []
    while True:
        try:
            ages_ms.append(_age_ms(waiting.get(timeout=_LAST_S)))
        except queue.Empty:
            if sender.poll() is not None:
                return ages_ms


def _age_ms(payload: bytes) -> float:
    return (time.monotonic_ns() - sent_ns(payload)) / 1e6
