"""The bounded queue between the bus's threads and ours; both buses use it."""

import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from typing import Generic, TypeVar

from .bus import Bell, Sample

Item = TypeVar("Item")


class SampleQueue(Generic[Item]):
    """A Subscription that gives every key, and every sender on it, a share.

    When full, it drops the oldest sample of the largest share and counts it, so that a busy sender
    pushes nobody else out.
    `push` and `miss` may be called from any thread; they only append and count. Items become
    Samples when they are taken: the bus's thread has no time for that.
    """

    def __init__(
        self,
        capacity: int,
        sample_of: Callable[[Item], Sample],
        close: Callable[[], None],
        *,
        key_of: Callable[[Item], str],
        share_of: Callable[[Item], str] | None = None,
        wanted: Callable[[str], bool] | None = None,
        in_turns: bool = False,
        bell: Bell | None = None,
    ) -> None:
        """`key_of`: an item's key; `share_of`: the share that an item belongs to, by default its
        key; `wanted`: whether a key's samples are kept; `in_turns`: the shares take turns, so that
        a busy sender delays only itself, otherwise samples are taken in order of arrival; `bell`:
        rung at each arrival, for readers of several queues."""
        self._bell = bell
        self._in_turns = in_turns
        self._shares: dict[str, deque[tuple[int, Item]]] = {}  # none is empty; the first is next
        self._count = 0
        self._capacity, self._sample_of = capacity, sample_of
        self._key_of, self._share_of, self._wanted = key_of, share_of or key_of, wanted
        self._lock = threading.Lock()
        self._filled = Bell()
        self._close = close
        self._is_closed = False
        self._received = 0
        self._dropped = 0
        self._lost: Counter[str] = Counter()

    def push(self, item: Item) -> None:
        """Append an item; called on the bus's thread."""
        if self._wanted is not None and not self._wanted(self._key_of(item)):
            return
        share = self._share_of(item)
        with self._lock:
            if self._is_closed:
                return
            self._received += 1
            if self._count == self._capacity:
                self._drop()
            self._shares.setdefault(share, deque()).append((self._received, item))
            self._count += 1
        self._filled.ring()
        if self._bell is not None:
            self._bell.ring()

    def _drop(self) -> None:
        # If nearly every share has one sample, searching for the fullest is useless.
        is_spread = 2 * len(self._shares) > self._capacity
        shares = self._shares
        item = self._pop(
            next(iter(shares)) if is_spread else max(shares, key=lambda s: len(shares[s]))
        )
        self._dropped += 1
        self._lost[self._key_of(item)] += 1

    def _pop(self, share: str) -> Item:
        items = self._shares[share]
        _, item = items.popleft()
        self._count -= 1
        if not items:
            del self._shares[share]
        return item

    def _next_share(self) -> str:
        """The share whose turn it is; without turns, the one with the oldest sample."""
        if self._in_turns or len(self._shares) == 1:
            return next(iter(self._shares))
        return min(self._shares, key=lambda share: self._shares[share][0][0])

    def miss(self, count: int) -> None:
        """Count samples that were lost in transit; called on the bus's thread."""
        with self._lock:
            self._dropped += count

    def take(self, timeout_s: float) -> Sample | None:
        deadline = time.monotonic() + timeout_s
        while (item := self._popped()) is None:
            if self._is_closed:
                self._filled.ring()  # whoever else waits
                return None
            left_s = deadline - time.monotonic()
            if left_s <= 0 or not self._filled.wait(left_s):
                return None
        return self._sample_of(item)

    def _popped(self) -> Item | None:
        with self._lock:
            if not self._shares:
                return None
            share = self._next_share()
            item = self._pop(share)
            if share in self._shares:  # to the end of the line
                self._shares[share] = self._shares.pop(share)
        if self._count:
            self._filled.ring()  # for whoever else waits
        return item

    @property
    def depth(self) -> int:
        return self._count

    @property
    def received(self) -> int:
        return self._received

    @property
    def losses(self) -> dict[str, int]:
        """Number of samples dropped from the full queue, by key."""
        with self._lock:
            return dict(self._lost)

    @property
    def dropped(self) -> int:
        return self._dropped

    def close(self) -> None:
        """Withdraw the declaration; waiting samples can still be taken."""
        with self._lock:
            if self._is_closed:
                return
            self._is_closed = True
        self._filled.ring()
        self._close()
