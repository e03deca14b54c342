"""Of each key the sample that came last, for readers that show a state and follow no course."""

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

from .bus import Sample

Item = TypeVar("Item")

MOST_KEYS = 4096
"""Several times the cameras and robots of any site."""


class LatestSamples(Generic[Item]):
    """Bounded by the number of keys; samples of more keys are dropped and counted.

    `push` and `miss` may be called from any thread; they only store and count. Items become Samples
    when they are taken: the bus's thread has no time for that.
    """

    def __init__(
        self,
        sample_of: Callable[[Item], Sample],
        close: Callable[[], None],
        *,
        key_of: Callable[[Item], str],
    ) -> None:
        self._sample_of, self._close, self._key_of = sample_of, close, key_of
        self._lock = threading.Lock()
        self._waiting: dict[str, Item] = {}
        self._is_closed = False
        self.received = self.dropped = 0

    def push(self, item: Item) -> None:
        """Keep an item in place of its key's last one; called on the bus's thread."""
        key = self._key_of(item)
        with self._lock:
            if self._is_closed:
                return
            self.received += 1
            if key in self._waiting or len(self._waiting) < MOST_KEYS:
                self._waiting[key] = item
            else:
                self.dropped += 1

    def miss(self, count: int) -> None:
        """Count samples that were lost in transit; called on the bus's thread."""
        with self._lock:
            self.dropped += count

    def take(self) -> list[Sample]:
        """The newest sample of each key that has one since the last call; never waits."""
        with self._lock:
            waiting, self._waiting = self._waiting, {}
        return [self._sample_of(item) for item in waiting.values()]

    @property
    def depth(self) -> int:
        return len(self._waiting)

    def close(self) -> None:
        """Withdraw the declaration; what waits can still be taken."""
        with self._lock:
            if self._is_closed:
                return
            self._is_closed = True
        self._close()
