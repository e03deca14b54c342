"""Prometheus's /metrics over HTTP.

One thread serves one client after the other. A client has a second in all, so that neither the
next one nor the program's end waits for who does not read.
"""

import socket
import socketserver
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer

from prometheus_client import CollectorRegistry, generate_latest, make_wsgi_app
from prometheus_client.metrics_core import Metric as Family

from trigpoint.base.errors import OperationError
from trigpoint.site.config import endpoint_host, endpoint_port

_CLIENT_S = 1.0
_POLL_S = 0.1


@contextmanager
def served(listen: str, collect: Callable[[], list[Family]]) -> Iterator[str]:
    """Serve what `collect` gives, at a checked HOST:PORT; gives the page's address.

    Raises OperationError if the address cannot be had.
    """
    host = endpoint_host(f"tcp/{listen}").strip("[]")
    port = endpoint_port(f"tcp/{listen}")
    registry = CollectorRegistry()
    registry.register(_Collector(collect))
    try:
        server = (_Server6 if ":" in host else _Server)((host, port), _Handler)
    except OSError as reason:
        raise OperationError(
            f"metrics cannot be served at {listen} ({reason.strerror}); each program on a machine "
            "needs a port of its own: give this one --metrics HOST:PORT, or --metrics off"
        ) from None
    server.set_app(make_wsgi_app(registry))
    thread = threading.Thread(target=server.serve_forever, args=(_POLL_S,), name="metrics")
    with server:
        thread.start()
        try:
            yield f"http://{listen.rpartition(':')[0]}:{server.server_port}/metrics"
        finally:
            server.shutdown()
            thread.join()


def exposition(collected: list[Family]) -> bytes:
    """Families as a page in Prometheus's text format, for who serves it himself."""
    registry = CollectorRegistry()
    registry.register(_Collector(lambda: collected))
    return generate_latest(registry)


class _Collector:
    def __init__(self, collect: Callable[[], list[Family]]) -> None:
        self.collect = collect


class _Server(WSGIServer):
    def server_bind(self) -> None:
        """Bind without asking a name server for this machine's name, as the library does."""
        socketserver.TCPServer.server_bind(self)
        self.server_name, self.server_port = "", self.socket.getsockname()[1]
        self.setup_environ()

    def handle_error(self, request: object, client_address: object) -> None:
        """Say nothing of a client that went away."""


class _Server6(_Server):
    address_family = socket.AF_INET6


class _Handler(WSGIRequestHandler):
    def handle(self) -> None:
        """Serve the client, and hang up when its time is over."""
        timer = threading.Timer(_CLIENT_S, _hang_up, (self.connection,))
        timer.start()
        try:
            super().handle()
        finally:
            timer.cancel()
            timer.join()

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002 - the library's name
        """Log no requests."""


def _hang_up(connection: socket.socket) -> None:
    with suppress(OSError):
        connection.shutdown(socket.SHUT_RDWR)
