"""A bus inside one process, for tests: several `MemoryBus` sessions share a `MemoryBroker`."""

import itertools
import threading
import time
from collections import deque
from collections.abc import Callable

from msgspec import Struct, field

from trigpoint.base.clock import Clock, SystemClock
from trigpoint.base.closing import Closing
from trigpoint.base.errors import BusError
from trigpoint.bus.bus import COMMAND_TIMEOUT_S, Bell, Closable, Reply, Sample
from trigpoint.bus.latest import LatestSamples
from trigpoint.bus.queue import SampleQueue
from trigpoint.bus.server import Server
from trigpoint.contract.topics import Topic, key_matches

_Listener = SampleQueue[Sample] | LatestSamples[Sample]


class MemoryBroker:
    """State shared by the sessions; its lock is held only while samples are appended to queues."""

    def __init__(self, clock: Clock | None = None) -> None:
        self.clock = clock or SystemClock()
        self.lock = threading.RLock()
        self.publishers: list[MemoryPublisher] = []
        self.subscriptions: list[tuple[str, _Listener]] = []
        self.tokens: list[str] = []
        self.servers: list[Server] = []
        self._numbers = itertools.count(1)

    def session(self) -> "MemoryBus":
        """Open one more session."""
        return MemoryBus(self, f"{next(self._numbers):032x}")


class MemoryPublisher:
    """Sends on one key; keeps as many samples as the topic's cache for late subscribers."""

    def __init__(self, broker: MemoryBroker, topic: Topic, key: str, identity: str) -> None:
        self._broker, self._topic, self._identity = broker, topic, identity
        self.key = key
        self.cache: deque[Sample] = deque(maxlen=topic.cache)
        self._is_closed = False
        with broker.lock:
            broker.publishers.append(self)

    def put(self, payload: bytes, *, attachment: bytes = b"") -> None:
        with self._broker.lock:
            if self._is_closed:
                raise BusError(f"the publisher on {self.key} is closed")
            now_ns = self._broker.clock.now_ns()
            sample = Sample(
                self.key,
                bytes(payload),
                self._topic.encoding,
                now_ns,
                now_ns,
                attachment,
                self._identity,
            )
            self.cache.append(sample)
            for queue in self._listeners():
                queue.push(sample)

    @property
    def has_listener(self) -> bool:
        with self._broker.lock:
            return bool(self._listeners())

    def close(self) -> None:
        with self._broker.lock:
            self._is_closed = True
            if self in self._broker.publishers:
                self._broker.publishers.remove(self)

    def _listeners(self) -> list[_Listener]:
        subscriptions = self._broker.subscriptions
        return [queue for expression, queue in subscriptions if key_matches(expression, self.key)]


class _Request(Struct):
    key: str
    payload: bytes
    answered: threading.Event = field(default_factory=threading.Event)
    result: Reply | None = None

    def reply(self, payload: bytes) -> None:
        self.result = Reply(self.key, bytes(payload))
        self.answered.set()

    def refuse(self, error: str) -> None:
        self.result = Reply(self.key, b"", error)
        self.answered.set()


class _Token:
    def __init__(self, broker: MemoryBroker, key: str) -> None:
        self._broker, self._key, self._is_closed = broker, key, False
        with broker.lock:
            broker.tokens.append(key)

    def close(self) -> None:
        with self._broker.lock:
            if not self._is_closed:
                self._is_closed = True
                self._broker.tokens.remove(self._key)


class MemoryBus(Closing):
    """One session; use `MemoryBroker.session()`."""

    def __init__(self, broker: MemoryBroker, identity: str) -> None:
        self._broker, self._identity = broker, identity
        self._declared: list[Closable] = []

    @property
    def identity(self) -> str:
        return self._identity

    @property
    def locators(self) -> tuple[str, ...]:
        return ()

    @property
    def peers(self) -> tuple[str, ...]:
        return ()

    @property
    def warning(self) -> str:
        return ""

    @property
    def certificate_days(self) -> float | None:
        return None

    @property
    def unreached(self) -> tuple[str, ...]:
        return ()

    @property
    def unsent(self) -> int:
        return 0

    def flush(self, timeout_s: float) -> bool:
        del timeout_s  # nothing waits
        return True

    def catch_up(self, site: str, timeout_s: float) -> bool:
        del site, timeout_s  # nothing is ever on its way
        return True

    def publisher(self, topic: Topic, key: str) -> MemoryPublisher:
        publisher = MemoryPublisher(self._broker, topic, key, self._identity)
        self._declared.append(publisher)
        return publisher

    def subscribe(
        self,
        topic: Topic,
        expression: str,
        *,
        wanted: Callable[[str], bool] | None = None,
        in_turns: bool = False,
        bell: Bell | None = None,
    ) -> SampleQueue[Sample]:
        queue: SampleQueue[Sample] = SampleQueue(
            topic.queue,
            lambda sample: sample,
            lambda: self._unsubscribe(queue),
            key_of=lambda sample: sample.key,
            wanted=wanted,
            in_turns=in_turns,
            bell=bell,
        )
        self._listen(topic, expression, queue)
        return queue

    def latest(self, topic: Topic, expression: str) -> LatestSamples[Sample]:
        latest: LatestSamples[Sample] = LatestSamples(
            lambda sample: sample,
            lambda: self._unsubscribe(latest),
            key_of=lambda sample: sample.key,
        )
        self._listen(topic, expression, latest)
        return latest

    def _listen(self, topic: Topic, expression: str, listener: _Listener) -> None:
        with self._broker.lock:
            if topic.cache:
                for sample in self._history(expression, topic.cache):
                    listener.push(sample)
            self._broker.subscriptions.append((expression, listener))
        self._declared.append(listener)

    def declare_alive(self, key: str) -> Closable:
        token = _Token(self._broker, key)
        self._declared.append(token)
        return token

    def alive(self, expression: str, *, timeout_s: float = COMMAND_TIMEOUT_S) -> list[str]:
        del timeout_s  # nothing to wait for
        with self._broker.lock:
            return sorted({key for key in self._broker.tokens if key_matches(expression, key)})

    def serve(self, key: str, answer: Callable[[bytes], bytes]) -> Closable:
        server = Server(key, answer)
        server.undeclare = lambda: self._withdraw(server)
        with self._broker.lock:
            self._broker.servers.append(server)
        self._declared.append(server)
        return server

    def query(
        self, key: str, payload: bytes = b"", *, timeout_s: float = COMMAND_TIMEOUT_S
    ) -> list[Reply]:
        with self._broker.lock:
            servers = [s for s in self._broker.servers if key_matches(key, s.key)]
        requests = [_Request(server.key, bytes(payload)) for server in servers]
        for server, request in zip(servers, requests, strict=True):
            server.submit(request)
        deadline = time.monotonic() + timeout_s
        for request in requests:
            request.answered.wait(max(0.0, deadline - time.monotonic()))
        return [request.result for request in requests if request.result is not None]

    def close(self) -> None:
        while self._declared:
            self._declared.pop().close()

    def _history(self, expression: str, count: int) -> list[Sample]:
        """Samples kept by the matching publishers: each key's latest `count`, in time order."""
        samples = [
            sample
            for publisher in self._broker.publishers
            if key_matches(expression, publisher.key)
            for sample in list(publisher.cache)[-count:]
        ]
        return sorted(samples, key=lambda sample: sample.published_ns)

    def _unsubscribe(self, listener: _Listener) -> None:
        with self._broker.lock:
            kept = [entry for entry in self._broker.subscriptions if entry[1] is not listener]
            self._broker.subscriptions[:] = kept

    def _withdraw(self, server: Server) -> None:
        with self._broker.lock:
            self._broker.servers.remove(server)
