"""A network camera by a real RTSP server: what its pictures' stamps are worth, and that a stream
which freezes, ends and comes back is noticed."""

import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from support.builders import eventually

from trigpoint.base.clock import SystemClock
from trigpoint.base.errors import FrameError
from trigpoint.edge.sources.frames import Frame
from trigpoint.edge.sources.frames_rtsp import RtspFrames
from trigpoint.site.config import CameraConfig

SERVER = Path(__file__).parents[1] / "support" / "site" / "rtsp_server.py"
SYSTEM_PYTHON = "/usr/bin/python3"
PROBE = (
    "import gi; gi.require_version('GstRtspServer', '1.0'); gi.require_version('Gst', '1.0');"
    "from gi.repository import Gst, GstRtspServer; Gst.init(None);"
    "assert Gst.ElementFactory.find('x264enc') and Gst.ElementFactory.find('rtph264pay')"
)
BLOCK, PER_ROW = 16, 20
# A stamp that is the picture's own is off by what the encoder takes; «now» at an opening was off by
# two seconds. Between them lies what a busy machine adds.
WORST_S = 0.5


@pytest.fixture(scope="module", autouse=True)
def has_server() -> None:
    """Skip where GStreamer's is not installed."""
    probe = [SYSTEM_PYTHON, "-c", PROBE]
    if not Path(SYSTEM_PYTHON).exists() or subprocess.run(probe, capture_output=True).returncode:
        pytest.skip(
            "no RTSP server here; Debian has one: gir1.2-gst-rtsp-server-1.0, python3-gi, "
            "gstreamer1.0-plugins-good and -ugly"
        )


class Server:
    """GStreamer's server as a process."""

    def __init__(self, port: int, codec: str = "h264") -> None:
        command = [SYSTEM_PYTHON, str(SERVER), str(port), codec]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == "ready\n"

    def tell(self, word: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(f"{word}\n")
        self._process.stdin.flush()

    def close(self) -> None:
        self._process.kill()
        self._process.communicate()


@contextmanager
def serving(port: int, codec: str = "h264") -> Iterator[Server]:
    server = Server(port, codec)
    try:
        yield server
    finally:
        server.close()


@contextmanager
def watching(port: int) -> Iterator[Iterator[Frame]]:
    url, stopping = f"rtsp://127.0.0.1:{port}/live", threading.Event()
    source = RtspFrames(url, CameraConfig(url, rate=15.0), clock=SystemClock())
    try:
        yield (frame for frame in source.frames(stopping) if isinstance(frame, Frame))
    finally:
        stopping.set()
        source.close()


def made_ns(picture: np.ndarray) -> int:
    """When a picture was made, as the server drew it."""
    micros = 0
    for bit in range(64):
        row, column = divmod(bit, PER_ROW)
        y, x = row * BLOCK + BLOCK // 2, column * BLOCK + BLOCK // 2
        micros |= int(picture[y, x].mean() > 128) << bit
    return micros * 1000


def exhaust(frames: Iterator[Frame]) -> None:
    """Take pictures until there are no more."""
    deque(frames, maxlen=0)


def errors_s(frames: Iterator[Frame], count: int) -> np.ndarray:
    found = [next(frames) for _ in range(count)]
    stamps = [frame.captured_ns for frame in found]
    assert stamps == sorted(set(stamps))
    return np.array([(frame.captured_ns - made_ns(frame.picture)) / 1e9 for frame in found])


@pytest.mark.parametrize("codec", ["h264", "jpeg"])
def test_pictures_are_stamped_with_their_own_time_from_the_first_on(
    free_port: Callable[[], int], codec: str
) -> None:
    port = free_port()
    with serving(port, codec), watching(port) as frames:
        errors = errors_s(frames, 30)
    assert np.abs(errors).max() < WORST_S
    assert np.ptp(errors) < WORST_S / 2


def test_frozen_stream_is_lost_and_comes_back(free_port: Callable[[], int]) -> None:
    port = free_port()
    with serving(port) as server:
        with watching(port) as frames:
            errors_s(frames, 5)
            server.tell("freeze")
            began_s = time.monotonic()
            with pytest.raises(FrameError, match=r"rtsp://127.0.0.1:\d+/live: no"):
                exhaust(frames)
            # Two seconds are the limit of a read; it took over six.
            assert time.monotonic() - began_s < 5.0
        server.tell("thaw")
        with watching(port) as frames:
            assert np.abs(errors_s(frames, 10)).max() < WORST_S


def test_restarted_server_is_found_again(free_port: Callable[[], int]) -> None:
    port = free_port()
    with serving(port), watching(port) as frames:
        errors_s(frames, 5)
    with watching(port) as frames, pytest.raises(FrameError, match="cannot be opened"):
        next(frames)
    with serving(port):
        found: list[float] = []

        def is_back() -> bool:
            with watching(port) as frames:
                try:
                    found.extend(errors_s(frames, 5))
                except FrameError:
                    return False
            return True

        assert eventually(is_back)
        assert np.abs(found).max() < WORST_S


def test_server_that_is_gone_is_a_lost_camera(free_port: Callable[[], int]) -> None:
    port = free_port()
    with serving(port) as server, watching(port) as frames:
        errors_s(frames, 3)
        server.close()
        with pytest.raises(FrameError):
            exhaust(frames)
