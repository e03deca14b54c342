"""The rerun viewer as a process of ours: native, or served to a browser on this machine alone.

The SDK's own server binds every interface; the viewer's program can be told to bind loopback. Its
program is started directly, since the `rerun` script is a wrapper whose end leaves it running.
"""

import ctypes
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import IO
from urllib.parse import quote

import rerun_cli
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.base.closing import Closing
from trigpoint.base.ending import ENDING
from trigpoint.base.errors import OperationError

from .page import LOOPBACK, ViewerPage

START_TIMEOUT_S = 20.0
STOP_TIMEOUT_S = 2.0
WEB_PORT = 9080
"""Of the page, where none is given: a fixed one, so that a tunnel to it works (and to the next
one, where the data are)."""
_LIBC = ctypes.CDLL(None)
_PR_SET_PDEATHSIG = 1
_MEMORY = "2GB"
"""What the viewer may hold; beyond, the oldest goes. A live site may be watched for weeks."""


class Ports(Struct, frozen=True):
    """`stream`: where data come in and viewers fetch them; `web`: the files of the web viewer."""

    stream: int
    web: int


class Viewer(Closing):
    """A running viewer; ends with `close`, or by itself when its window is closed."""

    def __init__(
        self, file: Path | None = None, *, is_web: bool, port: int = 0, host: str = LOOPBACK
    ) -> None:
        """Start it, with a file or to be streamed to; raise OperationError where it cannot run.

        Without `is_web` it opens a window, for which there must be a display. `port`: of the page;
        the data are at the next one; 0: ports that are free. `host`: the address that both are
        open to.
        """
        if not is_web and not has_display():
            raise OperationError(
                "there is no display for rerun's window; give --web and open its address in a "
                "browser, or for a session --save FILE.rrd"
            )
        self._is_web = is_web
        self._ports = Ports(*free_ports(2))
        self._host = host
        if port:
            _check_free(host, port)
            self._ports = replace(self._ports, stream=port + 1)
        self._folder = tempfile.TemporaryDirectory(prefix="trigpoint-rerun-")
        self._output = (Path(self._folder.name) / "output.txt").open("w+b")
        self._process = self._start(file)
        self._page: ViewerPage | None = None
        try:
            self._wait_until_ready()
            if is_web:
                self._page = ViewerPage(
                    files_port=self._ports.web,
                    stream_port=self._ports.stream,
                    port=port,
                    host=host,
                )
        except BaseException:
            self.close()
            raise

    @property
    def stream_url(self) -> str:
        """Where a recording connects to."""
        return f"rerun+http://{LOOPBACK}:{self._ports.stream}/proxy"

    @property
    def web_url(self) -> str:
        """What to open in a browser; "" where there is a window."""
        if self._page is None:
            return ""
        host = self._host
        stream = f"rerun+http://{host}:{self._ports.stream}/proxy"
        return f"http://{host}:{self._page.port}/?url={quote(stream, safe='')}"

    @property
    def process_id(self) -> int:
        return self._process.pid

    @property
    def is_running(self) -> bool:
        return self._process.poll() is None

    def close(self) -> None:
        """Stop it; harmless where it has ended already."""
        if self._page is not None:
            self._page.close()
            self._page = None
        self._process.terminate()
        try:
            self._process.wait(STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait(STOP_TIMEOUT_S)
        self._output.close()
        self._folder.cleanup()

    def _start(self, file: Path | None) -> subprocess.Popen[bytes]:
        command = [str(program()), *([str(file)] if file else [])]
        command += [
            "--bind",
            self._host,
            "--port",
            str(self._ports.stream),
            "--hide-welcome-screen",
        ]
        command += ["--memory-limit", _MEMORY, "--server-memory-limit", _MEMORY]
        if self._is_web:
            command += ["--serve-web", "--web-viewer-port", str(self._ports.web)]
        try:
            return subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=self._output,
                stderr=subprocess.STDOUT,
                env=os.environ | {"XDG_CONFIG_HOME": str(_quiet_settings(self._folder.name))},
                start_new_session=True,  # Ctrl-C reaches us, and we stop it in order
                preexec_fn=_end_with_parent if sys.platform == "linux" else None,
            )
        except OSError as reason:
            raise OperationError(
                f"rerun's viewer cannot be started ({reason.strerror}); "
                "run: pip install -c constraints.txt --force-reinstall rerun-sdk"
            ) from None

    def _wait_until_ready(self) -> None:
        ports = [self._ports.stream, *([self._ports.web] if self._is_web else [])]
        deadline = time.monotonic() + START_TIMEOUT_S
        while not all(_answers(port) for port in ports):
            if ENDING.is_asked:
                raise SystemExit(0)
            if not self.is_running:
                raise OperationError(f"rerun's viewer ended at once: {_last_line(self._output)}")
            if time.monotonic() > deadline:
                raise OperationError(f"rerun's viewer did not start in {START_TIMEOUT_S:.0f} s")
            time.sleep(0.05)


def _end_with_parent() -> None:
    """In the child, before it becomes the viewer: it ends when we do, however we are killed."""
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def _check_free(host: str, port: int) -> None:
    for one in (port, port + 1):
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((host, one))
            except OSError as reason:
                raise OperationError(
                    f"the viewer's port {one} on {host} cannot be had ({reason.strerror}); stop "
                    "what uses it, or give another --port"
                ) from None


def program() -> Path:
    """The viewer's own program."""
    suffix = ".exe" if sys.platform == "win32" else ""
    return Path(rerun_cli.__file__).parent / f"rerun{suffix}"


def has_display() -> bool:
    """Whether a window can be opened here."""
    if sys.platform in ("win32", "darwin"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def free_ports(count: int) -> list[int]:
    """Ports of loopback that are free now."""
    sockets = [socket.socket() for _ in range(count)]
    try:
        for one in sockets:
            one.bind((LOOPBACK, 0))
        return [one.getsockname()[1] for one in sockets]
    finally:
        for one in sockets:
            one.close()


def _quiet_settings(folder: str) -> Path:
    """A settings folder in which rerun's usage statistics are off, for this process alone."""
    settings = Path(folder) / "settings"
    file = settings / "rerun" / "analytics.json"
    file.parent.mkdir(parents=True)
    analytics = {
        "analytics_enabled": False,
        "analytics_id": "off",
        "metadata": {},
        "config_file_path": str(file),
        "data_dir_path": str(file.parent),
    }
    file.write_text(json.dumps(analytics))  # all five, or rerun takes its defaults
    return settings


def _answers(port: int) -> bool:
    try:
        socket.create_connection((LOOPBACK, port), timeout=0.2).close()
    except OSError:
        return False
    return True


def _last_line(output: IO[bytes]) -> str:
    output.seek(0)
    lines = output.read().decode(errors="replace").strip().splitlines()
    return lines[-1] if lines else "it said nothing"
