"""From put in one process to whoever takes it in another.

Our callback only appends to a queue, from which a thread takes; so does, for comparison, a bare one
with Python's own queue. A second process sends on both by turns, on loopback; the
clock is the system's monotonic one, which all processes of a machine share.
"""

import json
import queue
import socket
import time
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context

import numpy as np
import zenoh
from msgspec import Struct
from support.builders import eventually

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


class Load(Struct, frozen=True):
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
    what, against = f"put to taken, {load.what}", "zenoh's callback and a queue"
    ours, bare = (np.percentile(each, [50, 99]).tolist() for each in delays_ms(load))
    return [
        Row("bus", f"{what}, p50", "ms", ours[0], bare[0], against),
        Row("bus", f"{what}, p99", "ms", ours[1], bare[1], against),
    ]


def delays_ms(load: Load) -> tuple[list[float], list[float]]:
    """Milliseconds from put to whoever takes it, of each message after the first ones: through ours
    and through bare Zenoh."""
    endpoints = _free_endpoint(), _free_endpoint()
    waiting = queue.SimpleQueue[bytes]()
    with (
        ZenohBus(open_session(Settings("peer", listen=(endpoints[0],)))) as bus,
        _open_bare(listen=endpoints[1]) as session,
        session.declare_subscriber(_BARE_KEY, lambda s: waiting.put(s.payload.to_bytes())),
        ThreadPoolExecutor(2) as threads,
        ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool,
    ):
        subscription = bus.subscribe(load.topic, _OUR_KEY)
        sender = pool.submit(_send, load, *endpoints)
        ours = threads.submit(_taken, lambda: _payload(subscription), sender)
        bare = threads.submit(_taken, lambda: _waited(waiting), sender)
        sender.result()
        return ours.result()[_WARM_UP:], bare.result()[_WARM_UP:]


def _taken(take: Callable[[], bytes | None], sender: Future[None]) -> list[float]:
    """The age of each message as it is taken, until the sender has ended and none comes any more;
    `take` waits for a while."""
    ages_ms: list[float] = []
    while True:
        payload = take()
        if payload is not None:
            put_ns = int.from_bytes(payload[:_STAMP_BYTES], "little")
            ages_ms.append((time.monotonic_ns() - put_ns) / 1e6)
        elif sender.done():
            return ages_ms


def _payload(subscription: Subscription) -> bytes | None:
    sample = subscription.take(_LAST_S)
    return None if sample is None else sample.payload


def _waited(waiting: "queue.SimpleQueue[bytes]") -> bytes | None:
    try:
        return waiting.get(timeout=_LAST_S)
    except queue.Empty:
        return None


def _send(load: Load, ours_at: str, bare_at: str) -> None:
    """Put by turns on ours and on bare Zenoh, as soon as someone listens to both."""
    settings = Settings("peer", listen=(LOOPBACK,), connect=(ours_at,))
    with (
        ZenohBus(open_session(settings)) as bus,
        _open_bare(connect=bare_at) as session,
        session.declare_publisher(_BARE_KEY) as bare,
    ):
        ours = bus.publisher(load.topic, _OUR_KEY)
        if not eventually(lambda: ours.has_listener and _matches(bare), _PATIENCE_S):
            raise RuntimeError("nobody listens")
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
