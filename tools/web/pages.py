"""The pages that are open, and what waits for each; one that does not read is never awaited."""

import asyncio
import threading
from collections import deque
from contextlib import suppress

import msgspec

from trigpoint.base.errors import OperationError


def event(message: object) -> bytes:
    return b"data: " + msgspec.json.encode(message) + b"\n\n"


class Page:
    """One open page's queue; made in the loop of the server, filled from any thread. `most`: how
    many messages may wait, 1 where only the newest matters."""

    def __init__(self, first: bytes, most: int) -> None:
        self._loop = asyncio.get_running_loop()
        self._most = most
        self._waiting: deque[bytes] = deque([first] if first else [], most)
        self._is_new = asyncio.Event()
        self._is_ended = False

    def offer(self, message: bytes) -> bool:
        """Queue a message; false, and the page's end, where it has too many already."""
        is_full = len(self._waiting) == self._most > 1
        if is_full:
            self._waiting.clear()
            self.end()
        else:
            self._waiting.append(message)
            self._wake()
        return not is_full

    def end(self) -> None:
        """Have `take` return nothing once what waits is taken."""
        self._is_ended = True
        self._wake()

    async def take(self) -> bytes:
        """All that waits, joined, waited for; empty once the page has ended."""
        while not self._waiting and not self._is_ended:
            await self._is_new.wait()
            self._is_new.clear()
        messages = []
        with suppress(IndexError):  # until it is empty
            while True:
                messages.append(self._waiting.popleft())
        return b"".join(messages)

    def _wake(self) -> None:
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._is_new.set)


class Pages:
    """All of them, `most` at most, with so many messages `waiting` for each; `dropped`: how many
    did not read. Any thread."""

    def __init__(self, *, most: int, waiting: int) -> None:
        self._most, self._most_waiting = most, waiting
        self._lock = threading.RLock()
        self._pages: set[Page] = set()
        self._is_closed = False
        self.dropped = 0

    @property
    def pages(self) -> int:
        return len(self._pages)

    def open(self, first: bytes) -> Page:
        """A further page, which begins with a message. Called in the server's loop; raises
        OperationError where there are too many."""
        with self._lock:
            if len(self._pages) >= self._most or self._is_closed:
                raise OperationError(f"{self._most} pages are open already; close one")
            page = Page(first, self._most_waiting)
            self._pages.add(page)
        return page

    def offer(self, message: bytes) -> None:
        """Queue a message for every page; those that have too many already are dropped."""
        with self._lock:
            slow = {page for page in self._pages if not page.offer(message)}
            self._pages -= slow
            self.dropped += len(slow)

    def leave(self, page: Page, *, is_slow: bool = False) -> None:
        """Forget a page that is gone; `is_slow`: since it did not take what it was sent."""
        with self._lock:
            self.dropped += is_slow and page in self._pages
            self._pages.discard(page)

    def close(self) -> None:
        with self._lock:
            self._is_closed = True
            for page in self._pages:
                page.end()
            self._pages.clear()
