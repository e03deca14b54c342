"""The page's addresses. Nothing that a request says becomes a path to a file."""

import asyncio
import math
from collections.abc import Callable
from contextlib import suppress
from urllib.parse import parse_qs

from msgspec import Struct
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route

from trigpoint.base.errors import InputError
from trigpoint.contract.messages import FaceSighting
from trigpoint.tools.web.access import Guard, sent_on
from trigpoint.tools.web.answers import (
    SEND_S,
    EventStream,
    json_answer,
    kept,
    packaged,
    served_app,
)

from .feed import Feed
from .history import History
from .operator import Commands
from .pictures import Pictures

OPEN_PATHS = frozenset({"/login", "/board.css", "/mark.svg"})
"""What the login needs before anybody has logged in."""
_LOGIN_DELAY_S = 1.0
_MOST_FORM = 4096


def assets() -> dict[str, bytes]:
    return packaged("trigpoint.tools.board")


class Board(Struct, frozen=True):
    """What the addresses give. `picture`: PNG of the floor's «plan» or «grid»; `metrics`: those of
    all nodes, as Prometheus reads them; `commands`: None where the page only reads."""

    files: dict[str, bytes]
    guard: Guard
    feed: Feed
    history: History
    pictures: Pictures
    picture: Callable[[str], bytes]
    metrics: Callable[[], bytes]
    commands: Commands | None = None

    @property
    def app(self) -> Starlette:
        routes = [
            Route("/login", self._login, methods=["GET", "POST"]),
            Route("/events", self._events),
            Route("/past", self._past),
            Route("/plan.png", self._laid),
            Route("/grid.png", self._laid),
            Route("/metrics", self._metrics),
            Route("/camera/{name}/look", self._look),
            Route("/camera/{name}/picture/{stamp:int}", self._picture),
        ]
        if self.commands is not None:
            routes.append(Route("/command/{name:path}", self._command, methods=["POST"]))
        return served_app(self.files, "board.html", routes, self.guard)

    async def _laid(self, request: Request) -> Response:
        name = request.url.path.strip("/").partition(".")[0]
        if not (data := self.picture(name)):
            raise InputError(f"the site has no {name}")
        return kept(request, data, "image/png")

    async def _login(self, request: Request) -> Response:
        if request.method != "POST":
            return Response(self.files["login.html"], media_type="text/html")
        given = parse_qs(await _form(request)).get("token", [""])[0]
        if not self.guard.is_token(given.strip()):
            await asyncio.sleep(_LOGIN_DELAY_S)
            page = self.files["login.html"].replace(b'"alert">', b'"alert">That is not the word.')
            return Response(page, 401, media_type="text/html")
        return self.guard.let_in(sent_on(request, "/"))

    async def _events(self, request: Request) -> Response:
        feed, history = self.feed, self.history
        ways = await run_in_threadpool(history.ways, feed.now_s)
        return self.guard.let_in(EventStream(request, feed.join(ways), feed))

    async def _past(self, request: Request) -> Response:
        try:
            at_s = float(request.query_params.get("at", ""))
        except ValueError:
            at_s = math.nan
        if not math.isfinite(at_s):
            return PlainTextResponse("`at` is a Unix time in seconds", 400)
        whole = await run_in_threadpool(self.history.at, at_s)
        if whole is None:
            return PlainTextResponse("nothing is kept yet", 404)
        return json_answer(whole)

    async def _metrics(self, _: Request) -> Response:
        text = await run_in_threadpool(self.metrics)
        return Response(text, media_type="text/plain; version=0.0.4; charset=utf-8")

    async def _look(self, request: Request) -> Response:
        after = request.query_params.get("after", "0")
        if not after.isdecimal() or len(after) > 19:
            return PlainTextResponse("`after` is a stamp in nanoseconds", 400)
        camera, newest = request.path_params["name"], self.pictures.newest
        picture, faces = await run_in_threadpool(newest, camera, int(after))
        return json_answer({"stamp": str(picture.stamp_ns), "faces": [_face(one) for one in faces]})

    async def _picture(self, request: Request) -> Response:
        name, stamp_ns = request.path_params["name"], request.path_params["stamp"]
        data = self.pictures.jpeg(name, stamp_ns)
        if data is None:
            raise InputError("that picture is not kept any more")
        return Response(data, media_type="image/jpeg")

    async def _command(self, request: Request) -> Response:
        assert self.commands is not None  # else there is no such route
        name = request.path_params["name"]
        data, media_type = await run_in_threadpool(self.commands.give, name)
        return Response(data, media_type=media_type)


async def _form(request: Request) -> str:
    """A short form that comes at once; else nothing."""
    body = b""
    with suppress(TimeoutError):
        async with asyncio.timeout(SEND_S):
            async for part in request.stream():
                body += part
                if len(body) > _MOST_FORM:
                    return ""
            return body.decode(errors="replace")
    return ""


def _face(face: FaceSighting) -> dict[str, object]:
    """`pixels`: columns and rows in turn, by tenths."""
    pixels = [round(value, 1) for value in face.pixels.reshape(-1).tolist()]
    return {"target": face.target, "face": face.face, "pixels": pixels}
