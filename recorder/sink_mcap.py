"""Records into an MCAP file on a thread of its own.

A chunk is closed when it is full or half a second old and goes to the operating system at once, so
a recorder that is killed loses no more than that. Every five seconds the file is synchronised with
the disk, which bounds what a power cut takes and spares SD cards.
"""

import logging
import threading
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from trigpoint.clock import Clock, to_ns
from trigpoint.errors import OperationError
from trigpoint.topics import Topic
from trigpoint.watchdog import Pulse

from .mcap_writer import McapWriter

CHUNK_AGE_S = 0.5
SYNCHRONISE_S = 5.0
QUEUE_BYTES = 64 * 2**20
CLOSE_TIMEOUT_S = 10.0
_TICK_S = 0.1

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class _Message:
    topic: Topic
    key: str
    data: bytes
    log_ns: int
    published_ns: int


@dataclass(frozen=True, slots=True)
class _Attachment:
    name: str
    data: bytes
    media_type: str
    time_ns: int


class McapSink:
    """One session file; the methods may be called from any thread and do not wait for the disk."""

    def __init__(self, path: Path, *, clock: Clock) -> None:
        """Create the file; raise OperationError where it cannot be or is there already."""
        self._clock = clock
        self._writer = McapWriter(path)
        self._queue: deque[_Message | _Attachment] = deque()
        self._queued_bytes = 0
        self._lost = 0
        self._is_closing = False
        self._error: OperationError | None = None
        self._condition = threading.Condition()
        self._pulse: Pulse | None = None
        self._flushed_ns = self._synchronised_ns = clock.elapsed_ns()
        self._thread = threading.Thread(target=self._run, name="mcap", daemon=True)
        self._thread.start()

    def watch(self, pulse: Pulse) -> None:
        """Have the writing thread beat this from now on: a disk that hangs is noticed."""
        self._pulse = pulse

    @property
    def path(self) -> Path:
        return self._writer.path

    @property
    def depth(self) -> int:
        """How many messages wait for the disk."""
        return len(self._queue)

    @property
    def lost(self) -> int:
        """How many messages were not recorded since the disk was too slow."""
        return self._lost

    @property
    def counts(self) -> dict[str, int]:
        """How many messages of each key were written; complete after `close`."""
        return dict(self._writer.counts)

    def write(
        self, topic: Topic, key: str, payload: bytes, *, log_ns: int, published_ns: int
    ) -> bool:
        """Queue one message; False where 64 MiB wait already and it is lost.

        Raises OperationError once the file cannot be written any more.
        """
        return self._put(_Message(topic, key, payload, log_ns, published_ns))

    def attach(self, name: str, data: bytes, media_type: str) -> None:
        """Queue a file to attach."""
        self._put(_Attachment(name, data, media_type, self._clock.now_ns()))

    def close(self) -> None:
        """Write what waits and finish the file; raise OperationError where that failed."""
        with self._condition:
            self._is_closing = True
            self._condition.notify()
        self._thread.join(CLOSE_TIMEOUT_S)
        if self._thread.is_alive():
            raise OperationError(f"{self.path}: the disk does not answer, so its end is missing")
        if self._error:
            raise self._error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self.close()
        except OperationError as reason:
            if error is None:
                raise
            if reason is not error:
                _LOG.error("%s", reason)

    def _put(self, item: _Message | _Attachment) -> bool:
        with self._condition:
            if self._error:
                raise self._error
            if self._is_closing or self._queued_bytes + len(item.data) > QUEUE_BYTES:
                self._lost += 1
                return False
            self._queue.append(item)
            self._queued_bytes += len(item.data)
            return True

    def _run(self) -> None:
        try:
            while not self._is_closing:
                if self._pulse is not None:
                    self._pulse.beat()
                with self._condition:
                    self._condition.wait_for(lambda: self._is_closing, _TICK_S)
                self._write_all()
                self._keep()
            self._write_all()
            self._writer.finish()
        except OperationError as reason:
            self._writer.abandon()
            with self._condition:
                self._error = reason
        except Exception as reason:  # noqa: BLE001 - whatever a library raises must be told
            self._writer.abandon()
            with self._condition:
                self._error = OperationError(f"the recording broke off: {reason!r}")

    def _write_all(self) -> None:
        while items := self._take():
            for item in items:
                if isinstance(item, _Attachment):
                    self._writer.attach(item.name, item.data, item.media_type, time_ns=item.time_ns)
                else:
                    self._writer.add(
                        item.topic,
                        item.key,
                        item.data,
                        log_ns=item.log_ns,
                        published_ns=item.published_ns,
                    )

    def _take(self) -> list[_Message | _Attachment]:
        with self._condition:
            items = list(self._queue)
            self._queue.clear()
            self._queued_bytes = 0
        return items

    def _keep(self) -> None:
        """Close the chunk by its age; synchronise from time to time."""
        now_ns = self._clock.elapsed_ns()
        if now_ns - self._flushed_ns >= to_ns(CHUNK_AGE_S):
            self._writer.flush()
            self._flushed_ns = now_ns
        if now_ns - self._synchronised_ns >= to_ns(SYNCHRONISE_S):
            self._writer.synchronise()
            self._synchronised_ns = now_ns
