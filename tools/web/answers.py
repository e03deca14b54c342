"""What pages have in common: headers, a stream of events, files that a browser keeps."""

import asyncio
import zlib
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import suppress
from importlib import resources
from pathlib import PurePath

import msgspec
from starlette.applications import Starlette
from starlette.datastructures import MutableHeaders
from starlette.middleware import Middleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from trigpoint.base.errors import InputError, OperationError

from .access import DAY_S, Guard
from .pages import Page, Pages

_PACKAGE = "trigpoint.tools.web"
_TYPES = {
    ".html": "text/html",
    ".css": "text/css",
    ".js": "text/javascript",
    ".svg": "image/svg+xml",
}
SEND_S = 5.0
"""A page that takes nothing for so long is hung up on."""


def packaged(package: str) -> dict[str, bytes]:
    """The files of a package's page, by name, and those that all pages share."""
    folders = [resources.files(each).joinpath("page") for each in (_PACKAGE, package)]
    files = {file.name: file for folder in folders for file in folder.iterdir()}
    return {name: files[name].read_bytes() for name in sorted(files) if media_type(name)}


def media_type(name: str) -> str:
    """Of a file of a page; "" where it is none."""
    return _TYPES.get(PurePath(name).suffix, "")


def version_of(files: dict[str, bytes]) -> str:
    """Another one where any file is another; an open page then loads itself anew."""
    return f"{zlib.crc32(b''.join(files.values())):08x}"


class Guarded:
    """Refuses who may not come in, and gives every answer its headers."""

    def __init__(self, app: ASGIApp, guard: Guard) -> None:
        self._app, self._guard = app, guard

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            return

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers.update(self._guard.headers)
                headers.setdefault("Cache-Control", "no-store")
            await send(message)

        refusal = self._guard.refusal(Request(scope))
        await (refusal or self._app)(scope, receive, with_headers)


def served_app(files: dict[str, bytes], front: str, routes: list[Route], guard: Guard) -> Starlette:
    """The application of a page: `front` at its address, those routes, and each of its files that
    the browser keeps. A route that raises InputError is answered with 404, one that raises
    OperationError with 503, and with its line."""

    async def page(_: Request) -> Response:
        return guard.let_in(Response(files[front], media_type=media_type(front)))

    async def asset(request: Request) -> Response:
        name = request.url.path.lstrip("/")
        return kept(request, files[name], media_type(name))

    assets = [Route(f"/{name}", asset) for name in files if not name.endswith(".html")]
    return Starlette(
        routes=[Route("/", page), *routes, *assets],
        middleware=[Middleware(Guarded, guard=guard), Middleware(GZipMiddleware)],
        exception_handlers={InputError: _refused(404), OperationError: _refused(503)},
    )


def _refused(status: int) -> Callable[[Request, Exception], Awaitable[Response]]:
    async def answer(_: Request, reason: Exception) -> Response:
        return PlainTextResponse(str(reason), status)

    return answer


class EventStream(Response):
    """Server-sent events until the page goes, or does not read; a day at most, so that the browser
    comes again and its login is prolonged."""

    def __init__(self, request: Request, page: Page, pages: Pages) -> None:
        is_packed = "gzip" in request.headers.get("accept-encoding", "")
        self._page, self._pages = page, pages
        packing = {"Content-Encoding": "gzip"} if is_packed else {}
        headers = {"Content-Type": "text/event-stream", "X-Accel-Buffering": "no", **packing}
        super().__init__(headers=headers)
        del self.headers["content-length"]
        self._packer = zlib.compressobj(4, zlib.DEFLATED, 31) if is_packed else None

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        del scope  # all that matters of it is in the page's queue
        gone = asyncio.ensure_future(_disconnected(receive))
        gone.add_done_callback(lambda _: self._page.end())
        start = {"type": "http.response.start", "status": 200, "headers": self.raw_headers}
        end = {"type": "http.response.body", "body": b"", "more_body": False}
        is_slow = False

        async def put(body: Message) -> None:
            nonlocal is_slow
            try:
                await asyncio.wait_for(send(body), SEND_S)
            except TimeoutError:
                is_slow = True
                raise

        try:
            with suppress(TimeoutError):  # without its end the server hangs up
                async with asyncio.timeout(DAY_S):
                    await send(start)
                    async for data in self._messages():
                        await put({"type": "http.response.body", "body": data, "more_body": True})
                    if not gone.done():
                        await put(end)
        finally:
            gone.cancel()
            self._pages.leave(self._page, is_slow=is_slow)

    async def _messages(self) -> AsyncIterator[bytes]:
        yield self._pack(b"retry: 1000\n\n")
        while message := await self._page.take():
            yield self._pack(message)

    def _pack(self, data: bytes) -> bytes:
        if self._packer is None:
            return data
        return self._packer.compress(data) + self._packer.flush(zlib.Z_SYNC_FLUSH)


async def _disconnected(receive: Receive) -> None:
    while (await receive())["type"] != "http.disconnect":
        pass


def kept(request: Request, body: bytes, media_type: str) -> Response:
    """A file that the browser keeps, and asks about each time."""
    tag = f'"{zlib.crc32(body):08x}"'
    headers = {"ETag": tag, "Cache-Control": "no-cache"}
    if tag in request.headers.get("if-none-match", ""):  # packed ones come back as W/"…"
        return Response(status_code=304, headers=headers)
    return Response(body, media_type=media_type, headers=headers)


def json_answer(value: object) -> Response:
    return Response(msgspec.json.encode(value), media_type="application/json")
