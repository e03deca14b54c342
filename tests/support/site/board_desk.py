"""A board served in this process, on a bus in memory, and whoever asks it."""

import http.client
import json
import ssl
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from urllib.parse import urlsplit

import pytest
from support.builders import eventually

from trigpoint.site.config import Site
from trigpoint.testing.memory_bus import MemoryBroker
from trigpoint.tools.board import command
from trigpoint.tools.board.command import BoardService
from trigpoint.tools.web.access import Access


@dataclass(frozen=True, slots=True)
class Answer:
    status: int
    headers: dict[str, str]
    body: bytes


@dataclass(frozen=True, slots=True)
class Desk:
    """A served board; `broker`: its bus; `context`: by which it is asked over TLS."""

    address: str
    broker: MemoryBroker
    service: BoardService
    context: ssl.SSLContext | None = None

    @property
    def port(self) -> int:
        return urlsplit(self.address).port or 0

    def ask(self, path: str, method: str = "GET", *, body: str = "", **headers: str) -> Answer:
        """One request on a connection of its own; headers with _ in place of -."""
        connection = self.connected()
        try:
            sent = {name.replace("_", "-"): value for name, value in headers.items()}
            connection.request(method, path, body or None, sent)
            answer = connection.getresponse()
            named = {name.lower(): value for name, value in answer.getheaders()}
            return Answer(answer.status, named, answer.read())
        finally:
            connection.close()

    def connected(self) -> http.client.HTTPConnection:
        """A connection of one's own."""
        if self.context is None:
            return http.client.HTTPConnection("127.0.0.1", self.port, timeout=20)
        return http.client.HTTPSConnection("127.0.0.1", self.port, timeout=20, context=self.context)

    @contextmanager
    def events(self, **headers: str) -> Iterator[Iterator[dict]]:
        """The messages of /events, one after the other."""
        connection = self.connected()
        try:
            connection.request("GET", "/events", headers=headers)
            answer = connection.getresponse()
            assert answer.status == 200, answer.read()
            lines = iter(answer.readline, b"")
            yield (json.loads(line[6:]) for line in lines if line.startswith(b"data: "))
        finally:
            connection.close()


@contextmanager
def served_board(
    site: Site,
    monkeypatch: pytest.MonkeyPatch,
    *,
    access: Access | None = None,
    port: int = 0,
    is_operator: bool = False,
    opens_bus: bool = False,
) -> Iterator[Desk]:
    """A board on a bus in memory, until the end of the `with` block; `opens_bus`: on the site's
    own."""
    said: list[str] = []
    monkeypatch.setattr(command.typer, "echo", said.append)
    broker, errors = MemoryBroker(), []
    service = BoardService(site, access or Access(), is_operator=is_operator)

    def run() -> None:
        try:
            service.run(port, None if opens_bus else broker.session())
        except BaseException as reason:  # noqa: BLE001 - raised in the test's own thread
            errors.append(reason)

    thread = threading.Thread(target=run, name="board")
    thread.start()
    try:
        assert eventually(lambda: bool(said or errors))
        if errors:
            raise errors[0]
        trusted = access.certificate if access else None
        context = ssl.create_default_context(cafile=trusted) if trusted else None
        yield Desk(said[0].rpartition(" ")[2], broker, service, context)
    finally:
        service.stop()
        thread.join()
    if errors:
        raise errors[0]
