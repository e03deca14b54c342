"""Hands what changes to every open page; a page that does not read is dropped, never awaited."""

import asyncio
import threading
from collections import deque
from collections.abc import Mapping

import msgspec

from trigpoint.base.errors import OperationError

from .entities import Change, Entities, Fields, Whole, apply, difference

MOST_PAGES = 24
MOST_WAITING = 50
"""Changes that may wait for one page: five seconds' worth."""
QUIET_S = 1.0
"""Something is sent at least this often, so that a page knows a silent server from a still site."""


class TooManyPagesError(OperationError):
    """No further page is served."""


class Page:
    """One open page's queue; made in the loop of the server, filled from the reader's thread."""

    def __init__(self, first: bytes) -> None:
        self._loop = asyncio.get_running_loop()
        self._waiting: deque[bytes] = deque([first])
        self._filled = asyncio.Event()
        self._filled.set()
        self.is_ended = False

    def offer(self, message: bytes) -> bool:
        """Queue a message; false, and the page's end, where it has too many already."""
        is_full = len(self._waiting) >= MOST_WAITING
        if is_full:
            self._waiting.clear()
            self.is_ended = True
        else:
            self._waiting.append(message)
        self._wake()
        return not is_full

    def end(self) -> None:
        """Have `take` return nothing from now on. Any thread."""
        self.is_ended = True
        self._wake()

    async def take(self) -> bytes:
        """All that waits, joined; empty once the page has ended."""
        await self._filled.wait()
        self._filled.clear()
        messages = []
        while self._waiting and not self.is_ended:
            messages.append(self._waiting.popleft())
        return b"".join(messages)

    def _wake(self) -> None:
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._filled.set)


class Feed:
    """What is shown now, and the pages that it is shown on. Any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._shown: Entities = {}
        self._pages: set[Page] = set()
        self._said_s = self.now_s = 0.0
        self._is_closed = False
        self.dropped = 0

    def update(self, now: Mapping[str, Fields | None], t: float) -> Change:
        """Take these entities' state now, and send what is different; returns it."""
        with self._lock:
            change = difference(self._shown, now, round(t, 2))
            apply(self._shown, change)
            self.now_s = t
            if change.is_empty and t - self._said_s < QUIET_S:
                return change
            self._said_s = t
            message = event(change)
            for page in [page for page in self._pages if not page.offer(message)]:
                self._pages.discard(page)
                self.dropped += 1
        return change

    def join(self, ways: dict[str, list[float]]) -> Page:
        """A further page, which begins with the whole state and the robots' `ways` up to now.
        Called in the server's loop."""
        with self._lock:
            if len(self._pages) >= MOST_PAGES or self._is_closed:
                raise TooManyPagesError(f"{MOST_PAGES} pages are open already; close one")
            page = Page(event(Whole(round(self.now_s, 2), dict(self._shown), ways)))
            self._pages.add(page)
        return page

    def leave(self, page: Page) -> None:
        with self._lock:
            self._pages.discard(page)

    def whole(self) -> Entities:
        """What is shown now."""
        with self._lock:
            return dict(self._shown)

    @property
    def pages(self) -> int:
        return len(self._pages)

    def close(self) -> None:
        """End every page."""
        with self._lock:
            self._is_closed = True
            for page in self._pages:
                page.end()
            self._pages.clear()


def event(message: Change | Whole) -> bytes:
    """A message as a server-sent event."""
    return b"data: " + msgspec.json.encode(message) + b"\n\n"
