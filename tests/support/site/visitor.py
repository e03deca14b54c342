"""Asks a web server of this machine, as a page does."""

import http.client
import json
import ssl
from collections.abc import Iterator
from contextlib import contextmanager
from urllib.parse import urlsplit

from msgspec import Struct


class Answer(Struct, frozen=True):
    status: int
    headers: dict[str, str]
    body: bytes


class Visitor(Struct, frozen=True):
    """`context`: by which the address is asked over TLS."""

    address: str
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
            yield (json.loads(line[6:]) for line in lines if line.startswith(b"data: {"))
        finally:
            connection.close()
