"""The page of `look`: newest wins. A page that reads slowly misses moments and is never waited
for."""

import asyncio
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager

import msgspec
import numpy as np
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route

from trigpoint.edge.picture_sender import encode_jpeg
from trigpoint.tools.web.access import Access, Guard
from trigpoint.tools.web.answers import MARK, EventStream, packaged, served_app
from trigpoint.tools.web.serving import served

from .shown import Shown

ASSETS = {
    "look.html": "text/html",
    "look.css": "text/css",
    "look.js": "text/javascript",
    MARK: "image/svg+xml",
}
MOST_PAGES = 8
_KEPT = 4
"""Pictures that a page may still ask for."""
_QUALITY = 75


class Moments:
    """The newest moment and the last pictures, for the pages that are open. Any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._pages: set[OpenPage] = set()
        self._pictures: deque[tuple[str, np.ndarray]] = deque(maxlen=_KEPT)
        self.newest = b""
        self.is_over = False

    def show(self, shown: Shown, picture: np.ndarray) -> None:
        """Show a moment; after the one that says how it ended there is none."""
        message = b"data: " + msgspec.json.encode(shown) + b"\n\n"
        with self._lock:
            self.newest = message
            self._pictures.append((shown.stamp, picture))
            for page in self._pages:
                page.wake()

    def close(self) -> None:
        """End every page, once it has taken the newest moment."""
        with self._lock:
            self.is_over = True
            for page in self._pages:
                page.wake()

    def jpeg(self, stamp: str) -> bytes | None:
        """One of the last pictures; None where it is not kept any more."""
        with self._lock:
            picture = next((one for name, one in self._pictures if name == stamp), None)
        return None if picture is None else encode_jpeg(picture, _QUALITY)

    def join(self) -> "OpenPage | None":
        """A further page, None where there are enough. Called in the server's loop."""
        with self._lock:
            if len(self._pages) >= MOST_PAGES or self.is_over:
                return None
            page = OpenPage(self)
            self._pages.add(page)
        return page

    def leave(self, page: "OpenPage") -> None:
        with self._lock:
            self._pages.discard(page)


class OpenPage:
    """One open page: it is given the newest moment whenever it is ready for one."""

    def __init__(self, moments: Moments) -> None:
        self._moments = moments
        self._loop = asyncio.get_running_loop()
        self._is_new = asyncio.Event()
        self._is_new.set()
        self._has_gone = False
        self._given = b""

    async def take(self) -> bytes:
        """The newest moment, once it is another; empty once the page has gone or all is over."""
        while not self._has_gone:
            await self._is_new.wait()
            self._is_new.clear()
            newest, is_over = self._moments.newest, self._moments.is_over
            if newest != self._given and not self._has_gone:
                self._given = newest
                if is_over:
                    self._is_new.set()
                return newest
            if is_over:
                break
        return b""

    def end(self) -> None:
        """Have `take` return nothing from now on. Any thread."""
        self._has_gone = True
        self.wake()

    def wake(self) -> None:
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._is_new.set)


@contextmanager
def page_served(moments: Moments, port: int) -> Iterator[str]:
    """Serve on this machine's loopback inside the `with` block; gives the page's address. Raises
    OperationError where the port cannot be had."""
    access = Access()
    with served(app_of(moments, Guard(access)), access, port) as address:
        try:
            yield address
        finally:
            moments.close()


def app_of(moments: Moments, guard: Guard) -> Starlette:
    """The application."""
    files = packaged("trigpoint.tools.look", ASSETS)

    async def front(_: Request) -> Response:
        return Response(files["look.html"], media_type="text/html")

    async def events(request: Request) -> Response:
        page = moments.join()
        if page is None:
            return PlainTextResponse(f"{MOST_PAGES} pages are open already; close one", 503)
        return EventStream(request, page, lambda: moments.leave(page))

    async def picture(request: Request) -> Response:
        data = await run_in_threadpool(moments.jpeg, request.path_params["stamp"])
        if data is None:
            return PlainTextResponse("that picture is not kept any more", 404)
        return Response(data, media_type="image/jpeg")

    routes = [
        Route("/", front),
        Route("/events", events),
        Route("/picture/{stamp}", picture),
    ]
    return served_app(files, ASSETS, routes, guard)
