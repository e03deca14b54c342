"""The bounded queue between the bus's threads and ours; both buses use it."""

import threading
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

from .bus import Sample

Item = TypeVar("Item")


class SampleQueue(Generic[Item]):
    """A Subscription over a deque: full, it drops the oldest sample and counts it.

    `push` and `miss` may be called from any thread; they only append and count. What is pushed is
    made a Sample when it is taken: the bus's thread has no time for it.
    """

    def __init__(
        self, capacity: int, sample_of: Callable[[Item], Sample], close: Callable[[], None]
    ) -> None:
        self._items: deque[Item] = deque()
        self._capacity, self._sample_of = capacity, sample_of
        self._changed = threading.Condition(threading.Lock())
        self._close = close
        self._is_closed = False
        self._received = 0
        self._dropped = 0

    def push(self, item: Item) -> None:
        """Append what came; called on the bus's thread."""
        with self._changed:
            if self._is_closed:
                return
            self._received += 1
            if len(self._items) == self._capacity:
                self._items.popleft()
                self._dropped += 1
            self._items.append(item)
            self._changed.notify()

    def miss(self, count: int) -> None:
        """Count samples that were lost on the way; called on the bus's thread."""
        with self._changed:
            self._dropped += count

    def take(self, timeout_s: float) -> Sample | None:
        with self._changed:
            self._changed.wait_for(lambda: self._items or self._is_closed, timeout_s)
            if not self._items:
                return None
            item = self._items.popleft()
        return self._sample_of(item)

    @property
    def depth(self) -> int:
        return len(self._items)

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
