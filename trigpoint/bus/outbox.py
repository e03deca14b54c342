"""Sends without blocking the caller: a bounded queue, and a thread that may block.

A reliable put blocks on a subscriber that does not read, until that one is cut off (after a
second); a thread that sends other things too must not block. A sender with nothing else to do
(`is_direct`) sends by itself, which halves the delay: handing over to a thread takes about as long
as Zenoh takes from process to process. Once such a send has blocked, the thread takes over for a
while.
"""

import logging
import math
import threading
import time
from collections import deque
from collections.abc import Callable

from trigpoint.base.errors import BusError

_log = logging.getLogger(__name__)

_CAPACITY = 4096
# Sending takes 30 µs; beyond this it is blocked by a receiver (or the machine is busy).
_WAITED_S = 0.05
# A receiver that does not read for a second is cut off, and reconnects.
_THREAD_S = 10.0

Send = Callable[[], None]


class Outbox:
    """Sends in order, one at a time. `put` may be called from any thread, and only appends unless
    the outbox `is_direct`. When it is full, the oldest is dropped and counted as `lost`, like
    whatever the bus refuses."""

    def __init__(self, name: str, capacity: int = _CAPACITY, *, is_direct: bool = False) -> None:
        self._name, self._is_direct = name, is_direct
        self._by_thread_until = self._held_until = -math.inf
        self._items: deque[Send] = deque()
        self._capacity = capacity
        self._changed = threading.Condition(threading.Lock())
        self._is_sending = False
        self._is_closed = False
        self._flushing = 0
        self._thread: threading.Thread | None = None
        self.lost = 0

    def put(self, send: Send) -> None:
        """Send it, or queue it for sending."""
        with self._changed:
            if self._is_closed:
                raise BusError("the bus is closed; nothing can be sent on it")
            if not self._sends_itself():
                self._append(send)
                return
            self._is_sending = True
        begin_s = time.monotonic()
        self._send(send)
        if (end_s := time.monotonic()) - begin_s > _WAITED_S:
            self._by_thread_until = end_s + _THREAD_S

    def hold(self, seconds: float) -> None:
        """Send nothing for this long; whatever is put meanwhile waits. `flush` ends the hold."""
        with self._changed:
            self._held_until = time.monotonic() + seconds

    def _sends_itself(self) -> bool:
        """Whether the caller sends: nothing is queued, and no recent send has blocked."""
        is_free = self._is_direct and self._is_empty()
        return is_free and time.monotonic() >= max(self._by_thread_until, self._held_until)

    def _append(self, send: Send) -> None:
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name=self._name, daemon=True)
            self._thread.start()
        if len(self._items) == self._capacity:
            self._items.popleft()
            self.lost += 1
        self._items.append(send)
        self._changed.notify_all()

    @property
    def waiting(self) -> int:
        """Number waiting behind the one being sent."""
        return len(self._items)

    def flush(self, timeout_s: float) -> bool:
        """Wait until everything is sent; return false on timeout."""
        with self._changed:
            self._flushing += 1
            self._held_until = -math.inf
            self._changed.notify_all()
            is_sent = self._changed.wait_for(self._is_empty, timeout_s)
            self._flushing -= 1
            return is_sent

    def close(self, timeout_s: float) -> bool:
        """Send what is queued within the time limit and end the thread; return whether it ended."""
        deadline = time.monotonic() + timeout_s
        is_sent = self.flush(timeout_s)
        with self._changed:
            self._is_closed = True
            self.lost += len(self._items)
            self._items.clear()
            self._changed.notify_all()
        if self._thread is None:
            return True
        self._thread.join(max(0.0, deadline - time.monotonic()) if not is_sent else timeout_s)
        return not self._thread.is_alive()

    def _is_empty(self) -> bool:
        return not self._items and not self._is_sending

    def _run(self) -> None:
        while (send := self._next()) is not None:
            self._send(send)

    def _send(self, send: Send) -> None:
        """Send one, then let the next one have its turn."""
        try:
            send()
        except BusError as reason:
            self.lost += 1
            _log.warning("%s", reason)
        finally:
            with self._changed:
                self._is_sending = False
                if self._items or self._flushing or self._is_closed:
                    self._changed.notify_all()

    def _next(self) -> Send | None:
        with self._changed:
            self._changed.wait_for(
                lambda: not self._is_sending and (self._items or self._is_closed)
            )
            while (left_s := self._held_until - time.monotonic()) > 0 and not self._is_closed:
                self._changed.wait(left_s)
            if not self._items:
                return None
            self._is_sending = True
            return self._items.popleft()
