"""The web server, on a thread of its own."""

import asyncio
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import uvicorn
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol

from trigpoint.base.errors import InputError, OperationError

from .access import LOOPBACK, Access

_MOST_CONNECTIONS = 64
_UNREAD_MS = 15_000
"""The system hangs up on who has not taken what was sent for so long."""
_REQUEST_S = 10.0
_STOP_S = 1


@contextmanager
def served(app: ASGIApp, access: Access, port: int) -> Iterator[str]:
    """Serve inside the `with` block; gives the page's address.

    Raises OperationError where the address cannot be had, InputError where the certificate and its
    key cannot be used.
    """
    with _bound(access.host, port) as listening:
        server = uvicorn.Server(_config(app, access))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]}, name="pages")
        thread.start()
        try:
            scheme = "https" if access.is_encrypted else "http"
            yield f"{scheme}://{access.shown}:{listening.getsockname()[1]}/"
        finally:
            server.should_exit = True
            thread.join()


class _Prompt(H11Protocol):
    """Hangs up on a connection on which no request is asked for, or none to its end, in time."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # pyright: ignore
        super().connection_made(transport)
        self._look_later()

    def data_received(self, data: bytes) -> None:
        is_idle = not self._is_busy
        super().data_received(data)
        if is_idle:
            self._look_later()

    def _look_later(self) -> None:
        self.loop.call_later(_REQUEST_S, self._look)

    def _look(self) -> None:
        if not self._is_busy and not self.transport.is_closing():
            self.transport.close()

    @property
    def _is_busy(self) -> bool:
        return self.cycle is not None and not self.cycle.response_complete


def _config(app: ASGIApp, access: Access) -> uvicorn.Config:
    config = uvicorn.Config(
        app,
        http=_Prompt,
        ws="none",
        lifespan="off",
        loop="asyncio",
        log_config=None,
        log_level="critical",  # what a client does wrong is answered, and no news
        access_log=False,
        server_header=False,
        date_header=True,
        proxy_headers=False,
        limit_concurrency=_MOST_CONNECTIONS,
        timeout_keep_alive=10,
        timeout_graceful_shutdown=_STOP_S,
        ssl_certfile=access.certificate,
        ssl_keyfile=access.key,
    )
    try:
        config.load()
    except OSError as reason:
        raise InputError(
            f"{access.certificate}, {access.key}: they are no certificate with its key "
            f"({reason.strerror or reason}); give PEM files that belong together"
        ) from None
    return config


def _bound(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _UNREAD_MS)
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        listening.bind((host, port))
        listening.listen()
    except (OSError, UnicodeError) as reason:
        listening.close()
        said = reason.strerror if isinstance(reason, OSError) else reason
        options = "--port" if host == LOOPBACK else "--port or --host"
        raise OperationError(
            f"the page cannot be served at {host}:{port} ({said}); give another {options}"
        ) from None
    return listening
