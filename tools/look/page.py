"""The page of `look`: newest wins. A page that reads slowly misses moments and is never waited
for."""

from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from trigpoint.base.errors import InputError
from trigpoint.edge.picture_sender import encode_jpeg
from trigpoint.tools.web.access import Access, Guard
from trigpoint.tools.web.answers import EventStream, packaged, served_app
from trigpoint.tools.web.pages import Page, Pages, event
from trigpoint.tools.web.serving import served

from .shown import Shown

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
    async def events(request: Request) -> Response:
        return EventStream(request, moments.join(), moments)

    async def picture(request: Request) -> Response:
        data = await run_in_threadpool(moments.jpeg, request.path_params["stamp"])
        if data is None:
            raise InputError("that picture is not kept any more")
        return Response(data, media_type="image/jpeg")

    routes = [Route("/events", events), Route("/picture/{stamp}", picture)]
    return served_app(packaged("trigpoint.tools.look"), "look.html", routes, guard)
