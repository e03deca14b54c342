"""From put in one process to another's callback, and to whoever takes it there.

Our callback only appends to a queue, from which a thread takes; so does, for comparison, a bare one
with Python's own queue. A second process sends on both by turns, on loopback; the
clock is the system's monotonic one, which all processes of a machine share.
"""

import json
import queue
import socket
import time
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context

import numpy as np
import zenoh

from benchmarks.table import Row, share_of
from trigpoint.bus.bus import Subscription
from trigpoint.bus.settings import LOOPBACK, Settings
from trigpoint.contract import topics
from trigpoint.contract.topics import Topic
from trigpoint.zenoh import ZenohBus, open_session

_LAST_S, _PATIENCE_S = 0.5, 10.0
_WARM_UP = 50
_STAMP_BYTES = 8
_OUR_KEY, _BARE_KEY = "lab/camera/ours", "lab/camera/bare"


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
    endpoints = _free_endpoint(), _free_endpoint()
    called, waiting = list[float](), queue.SimpleQueue[bytes]()

    def receive(sample: zenoh.Sample) -> None:
        payload = sample.payload.to_bytes()
        called.append(_age_ms(payload))
        waiting.put(payload)

    with (
        ZenohBus(open_session(Settings("peer", listen=(endpoints[0],)))) as bus,
        _open_bare(listen=endpoints[1]) as session,
        session.declare_subscriber(_BARE_KEY, receive),
        ThreadPoolExecutor(2) as threads,
        ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool,
    ):
        subscription = bus.subscribe(load.topic, _OUR_KEY)
        sender = pool.submit(_send, load, *endpoints)
        ours = threads.submit(_taken, subscription, sender)
        bare = threads.submit(_bare_taken, waiting, sender)
        ages, bare_ages = ours.result(), bare.result()
        sender.result()
    our_called, our_taken = (list(each)[_WARM_UP:] for each in zip(*ages, strict=True))
    return Delays(our_called, our_taken, called[_WARM_UP:], bare_ages[_WARM_UP:])


def _taken(subscription: Subscription, sender: Future[None]) -> list[tuple[float, float]]:
    """Take until the sender has ended and nothing comes any more: age at our callback, and now."""
    ages_ms: list[tuple[float, float]] = []
    while True:
        sample = subscription.take(_LAST_S)
        if sample is not None:
            age_ms, since_ms = _age_ms(sample.payload), (time.time_ns() - sample.received_ns) / 1e6
            ages_ms.append((age_ms - since_ms, age_ms))
        elif sender.done():
            return ages_ms


def _bare_taken(waiting: "queue.SimpleQueue[bytes]", sender: Future[None]) -> list[float]:
    ages_ms: list[float] = []
    while True:
        try:
            ages_ms.append(_age_ms(waiting.get(timeout=_LAST_S)))
        except queue.Empty:
            if sender.done():
                return ages_ms


def _age_ms(payload: bytes) -> float:
    return (time.monotonic_ns() - int.from_bytes(payload[:_STAMP_BYTES], "little")) / 1e6


def _send(load: Load, ours_at: str, bare_at: str) -> None:
    """Put by turns on ours and on bare Zenoh, as soon as someone listens to both."""
    settings = Settings("peer", listen=(LOOPBACK,), connect=(ours_at,))
    with (
        ZenohBus(open_session(settings)) as bus,
        _open_bare(connect=bare_at) as session,
        session.declare_publisher(_BARE_KEY) as bare,
    ):
        ours = bus.publisher(load.topic, _OUR_KEY)
        deadline = time.monotonic() + _PATIENCE_S
        while not (ours.has_listener and _matches(bare)):
            if time.monotonic() > deadline:
                raise RuntimeError("nobody listens")
            time.sleep(0.05)
        time.sleep(0.5)
        for _ in range(_WARM_UP + load.count):
            for put in (ours.put, bare.put):
                stamp = time.monotonic_ns().to_bytes(_STAMP_BYTES, "little")
                put(stamp.ljust(load.size, b"\0"))
                time.sleep(load.pause_s)
        time.sleep(0.5)


def _matches(publisher: zenoh.Publisher) -> bool:
    status = publisher.matching_status
    return bool(getattr(status, "matching", status))  # an object, though its stub says bool


def _free_endpoint() -> str:
    """An endpoint on loopback that nobody uses now."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        return f"tcp/127.0.0.1:{server.getsockname()[1]}"


def _open_bare(*, listen: str | None = None, connect: str | None = None) -> zenoh.Session:
    """A session with Zenoh's defaults, kept on loopback."""
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("listen/endpoints", json.dumps([listen or "tcp/127.0.0.1:0"]))
    config.insert_json5("connect/endpoints", json.dumps([connect] if connect else []))
    return zenoh.open(config)
