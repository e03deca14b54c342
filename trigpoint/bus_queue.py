"""The bounded queue between the bus's threads and ours; both buses use it."""

import threading
from collections import deque
from collections.abc import Callable

from .bus import Sample


class SampleQueue:
    """A Subscription over a deque: full, it drops the oldest sample and counts it.

    `push` and `miss` may be called from any thread; they only append and count.
    """

    def __init__(self, capacity: int, close: Callable[[], None] = lambda: None) -> None:
        self._samples: deque[Sample] = deque()
        self._capacity = capacity
        self._changed = threading.Condition(threading.Lock())
        self._close = close
        self._is_closed = False
        self._received = 0
        self._dropped = 0

    def push(self, sample: Sample) -> None:
        """Append a sample; called on the bus's thread."""
        with self._changed:
            if self._is_closed:
                return
            self._received += 1
            if len(self._samples) == self._capacity:
                self._samples.popleft()
                self._dropped += 1
            self._samples.append(sample)
            self._changed.notify()

    def miss(self, count: int) -> None:
        """Count samples that were lost on the way; called on the bus's thread."""
        with self._changed:
            self._dropped += count

    def take(self, timeout_s: float) -> Sample | None:
        with self._changed:
            self._changed.wait_for(lambda: self._samples or self._is_closed, timeout_s)
            return self._samples.popleft() if self._samples else None

    @property
    def depth(self) -> int:
        return len(self._samples)

    @property
    def received(self) -> int:
        return self._received

    @property
    def dropped(self) -> int:
        return self._dropped

    def close(self) -> None:
        """Take the declaration back; samples that wait can still be taken."""
        with self._changed:
            if self._is_closed:
                return
            self._is_closed = True
            self._changed.notify_all()
        self._close()
