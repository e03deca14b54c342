"""From put in one process to taken in another: our bus against bare Zenoh, on loopback.

A second process sends on both by turns (`bus_sender`); the clock is the system's monotonic one,
which all processes of a machine share.
"""

import subprocess
import sys
import time
from dataclasses import dataclass

import numpy as np
import zenoh

from trigpoint import topics
from trigpoint.bus import Subscription
from trigpoint.bus_settings import Settings
from trigpoint.bus_zenoh import ZenohBus, open_session
from trigpoint.topics import Topic

from .bus_wire import WARM_UP, Wire, free_endpoint, open_bare, sent_ns
from .table import Row, share_of

_TIMEOUT_S = 60.0
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
    ours, bare = delays_ms(load)
    return [
        Row(
            "bus",
            f"put to taken, {load.what}, p{percent}",
            "ms",
            float(np.percentile(ours, percent)),
            float(np.percentile(bare, percent)),
            "zenoh's callback",
        )
        for percent in (50, 99)
    ]


def delays_ms(load: Load) -> tuple[list[float], list[float]]:
    """Delay of each message through ours and through bare Zenoh, warming up left out."""
    wire = Wire(
        free_endpoint(), free_endpoint(), load.topic.name, load.size, load.count, load.pause_s
    )
    bare: list[float] = []

    def receive(sample: zenoh.Sample) -> None:
        bare.append(_age_ms(sample.payload.to_bytes()))

    with (
        ZenohBus(open_session(Settings("peer", listen=(wire.ours,)))) as bus,
        open_bare(listen=wire.bare) as session,
        session.declare_subscriber(wire.bare_key, receive),
    ):
        subscription = bus.subscribe(load.topic, wire.our_key)
        with subprocess.Popen(
            [sys.executable, "-m", "benchmarks.bus_sender", *wire.arguments]
        ) as sender:
            try:
                ours = _taken(subscription, sender)
            finally:
                sender.kill()
        if sender.returncode != 0:
            raise RuntimeError(f"the sender failed with status {sender.returncode}")
    return ours[WARM_UP:], bare[WARM_UP:]


def _taken(subscription: Subscription, sender: subprocess.Popen[bytes]) -> list[float]:
    """Take until the sender has ended and nothing comes any more."""
    ages_ms: list[float] = []
    deadline = time.monotonic() + _TIMEOUT_S
    while time.monotonic() < deadline:
        sample = subscription.take(_LAST_S)
        if sample is not None:
            ages_ms.append(_age_ms(sample.payload))
        elif sender.poll() is not None:
            break
    return ages_ms


def _age_ms(payload: bytes) -> float:
    return (time.monotonic_ns() - sent_ns(payload)) / 1e6
