"""Serves rerun's web viewer to a browser on this machine, and keeps the page to this machine.

The viewer's page sends usage statistics and looks for updates on its own. A content security policy
is the browser's way to forbid that, and rerun's server sets none; so its files are handed on from
here with one.
"""

import threading
import urllib.error
import urllib.request
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from trigpoint.base.closing import Closing

LOOPBACK = "127.0.0.1"
_TIMEOUT_S = 10.0
_PIECE = 1 << 16


class ViewerPage(Closing):
    """The page, until `close`."""

    def __init__(
        self, *, files_port: int, stream_port: int, port: int = 0, host: str = LOOPBACK
    ) -> None:
        """`files_port`: rerun's web server; `stream_port`: where the page may fetch data; `port`:
        the page's own, 0: a free one; `host`: the address that it is open to."""
        origin = f"http://{host}:{files_port}"
        policy = (
            "default-src 'self' 'unsafe-inline' 'unsafe-eval' 'wasm-unsafe-eval' data: blob:; "
            f"connect-src 'self' data: blob: http://{host}:{stream_port}"
        )
        self._server = ThreadingHTTPServer((host, port), _handler(origin, policy))
        self._server.daemon_threads = True
        self._thread = threading.Thread(
            target=self._server.serve_forever, kwargs={"poll_interval": 0.1}, name="viewer page"
        )
        self._thread.start()

    @property
    def port(self) -> int:
        return self._server.server_address[1]

    def close(self) -> None:
        """Stop serving."""
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()


def _handler(origin: str, policy: str) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        """Hands a GET on to rerun's server; each request has a thread."""

        def do_GET(self) -> None:
            try:
                with urllib.request.urlopen(origin + self.path, timeout=_TIMEOUT_S) as file:
                    self._answer(file)
            except urllib.error.HTTPError as reason:
                self.send_error(reason.code)
            except OSError:
                self.send_error(502, "rerun's server does not answer")

        def _answer(self, file: Any) -> None:
            self.send_response(file.status)
            self.send_header("Content-Security-Policy", policy)
            for name in ("Content-Type", "Content-Length", "Content-Encoding"):
                if value := file.headers.get(name):
                    self.send_header(name, value)
            self.end_headers()
            while piece := file.read(_PIECE):
                self.wfile.write(piece)

        def log_message(self, format: str, *_: object) -> None:  # noqa: A002 - the base's name
            """Browsers' requests are no news."""

    return Handler
