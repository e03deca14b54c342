"""What is to be sent and waits for nobody: a bounded queue, and a thread that may wait.

A put that must arrive waits for a subscriber that does not read, up to the time after which that
one is cut off; whoever reads a port or a camera must not.
"""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable

from .errors import BusError

_log = logging.getLogger(__name__)

_CAPACITY = 4096

Send = Callable[[], None]


class Outbox:
    """One thread that sends, in order. `put` may be called from any thread and only appends; where
    it is full the oldest is dropped and counted as `lost`, like what the bus refuses."""

    def __init__(self, name: str, capacity: int = _CAPACITY) -> None:
        self._name = name
        self._items: deque[Send] = deque()
        self._capacity = capacity
        self._changed = threading.Condition(threading.Lock())
        self._is_sending = False
        self._is_closed = False
        self._thread: threading.Thread | None = None
        self.lost = 0

    def put(self, send: Send) -> None:
        """Have it sent."""
        with self._changed:
            if self._is_closed:
                raise BusError("the bus is closed; nothing can be sent on it")
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
        """How many wait behind the one that is being sent."""
        return len(self._items)

    def flush(self, timeout_s: float) -> bool:
        """Wait until all is sent; whether it is in time."""
        with self._changed:
            return self._changed.wait_for(self._is_empty, timeout_s)

    def close(self, timeout_s: float) -> bool:
        """Send what waits, within a time, and end the thread; whether it ended."""
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
            try:
                send()
            except BusError as reason:
                self.lost += 1
                _log.warning("%s", reason)
            with self._changed:
                self._is_sending = False
                self._changed.notify_all()

    def _next(self) -> Send | None:
        with self._changed:
            self._changed.wait_for(lambda: self._items or self._is_closed)
            if not self._items:
                return None
            self._is_sending = True
            return self._items.popleft()
