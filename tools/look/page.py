"""The page of `look`: newest wins. A page that reads slowly misses moments and is never waited
for."""

from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route

from trigpoint.edge.picture_sender import encode_jpeg
from trigpoint.tools.web.access import Access, Guard
from trigpoint.tools.web.answers import MARK, EventStream, packaged, served_app
from trigpoint.tools.web.pages import Page, Pages, TooManyPagesError, event
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


class Moments(Pages):
    """The newest moment and the last pictures, for the pages that are open. Any thread."""

    def __init__(self) -> None:
        super().__init__(most=MOST_PAGES, waiting=1)
        self._pictures: deque[tuple[str, np.ndarray]] = deque(maxlen=_KEPT)
        self._newest = b""

    def show(self, shown: Shown, picture: np.ndarray) -> None:
        """Show a moment; after the one that says how it ended there is none."""
        with self._lock:
            self._newest = event(shown)
            self._pictures.append((shown.stamp, picture))
            self.offer(self._newest)

    def jpeg(self, stamp: str) -> bytes | None:
        """One of the last pictures; None where it is not kept any more."""
        with self._lock:
            picture = next((one for name, one in self._pictures if name == stamp), None)
        return None if picture is None else encode_jpeg(picture, _QUALITY)

    def join(self) -> Page:
        """A further page, which begins with the newest moment. Called in the server's loop."""
        with self._lock:
            return self.open(self._newest)


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
    files = packaged("trigpoint.tools.look", ASSETS)

    async def front(_: Request) -> Response:
        return Response(files["look.html"], media_type="text/html")

    async def events(request: Request) -> Response:
        try:
            return EventStream(request, moments.join(), moments)
        except TooManyPagesError as reason:
            return PlainTextResponse(str(reason), 503)

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
