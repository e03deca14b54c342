"""`v4l2://DEVICE` and `rtsp://…`: cameras that do not wait.

A thread of the source's own reads on and keeps the newest picture alone, since drivers and network
streams queue: whoever reads slowly would see the past.
"""

import threading
from collections.abc import Callable, Iterator
from typing import Protocol

import cv2
import numpy as np

from trigpoint.clock import Clock, to_ns
from trigpoint.config import CameraConfig
from trigpoint.errors import FrameError
from trigpoint.geometry import CameraModel

from .frames import Frame, local_path

_TIMEOUT_MS = 5000
_STALLED_S = 10.0
_LOOK_S = 0.2
_JOIN_S = 1.0
_OLDEST_NS = to_ns(2.0)


class Capture(Protocol):
    """What is needed of cv2.VideoCapture."""

    def read(self) -> tuple[bool, np.ndarray]: ...

    def get(self, propId: int) -> float: ...  # noqa: N803 - OpenCV's name

    def release(self) -> None: ...


class LiveFrames:
    """The newest picture of a capture that a thread reads; opened on that thread too, since it can
    take seconds. `stamp`: capture and clock to Unix time of a picture that was just read."""

    def __init__(
        self,
        name: str,
        open_capture: Callable[[], Capture],
        *,
        clock: Clock,
        stamp: Callable[[Capture, Clock], int],
    ) -> None:
        self._name, self._clock, self._stamp = name, clock, stamp
        self._changed = threading.Condition()
        self._newest: Frame | None = None
        self._lost = ""
        self._skipped = 0
        self._closing = threading.Event()
        self._thread = threading.Thread(
            target=self._read, args=(open_capture,), name=f"reads {name}", daemon=True
        )
        self._thread.start()

    @property
    def intrinsics(self) -> CameraModel | None:
        """Cameras do not tell."""
        return None

    @property
    def skipped(self) -> int:
        """How many pictures a newer one replaced before they were taken."""
        return self._skipped

    def frames(self, stopping: threading.Event) -> Iterator[Frame]:
        """The newest picture each time; raises FrameError when the camera is lost or stalls."""
        last_ns = self._clock.elapsed_ns()
        while not stopping.is_set():
            frame = self._take()
            if frame is not None:
                last_ns = self._clock.elapsed_ns()
                yield frame
            elif self._clock.elapsed_ns() - last_ns > to_ns(_STALLED_S):
                raise FrameError(f"{self._name}: no picture for {_STALLED_S:.0f} s; check it")

    def close(self) -> None:
        """Stop reading. A read that hangs in the driver ends by its own time limit."""
        self._closing.set()
        self._thread.join(_JOIN_S)

    def _take(self) -> Frame | None:
        """Wait a moment for a picture. Raises FrameError where there will be none."""
        with self._changed:
            self._changed.wait_for(lambda: self._newest is not None or self._lost, _LOOK_S)
            frame, self._newest = self._newest, None
            if frame is None and self._lost:
                raise FrameError(self._lost)
            return frame

    def _read(self, open_capture: Callable[[], Capture]) -> None:
        try:
            capture = open_capture()
            try:
                while not self._closing.is_set():
                    self._keep(capture)
            finally:
                capture.release()
        except FrameError as reason:
            with self._changed:
                self._lost = str(reason)
                self._changed.notify_all()

    def _keep(self, capture: Capture) -> None:
        is_read, picture = capture.read()
        if not is_read:
            raise FrameError(f"{self._name}: the camera was lost; check its cable or network")
        frame = Frame(picture, self._stamp(capture, self._clock))
        with self._changed:
            self._skipped += self._newest is not None
            self._newest = frame
            self._changed.notify_all()


class V4l2Frames(LiveFrames):
    """`v4l2:///dev/video0`: a camera of this machine, asked for the site file's size and rate."""

    def __init__(self, url: str, camera: CameraConfig, *, clock: Clock) -> None:
        device = local_path(url)
        if not device.exists():
            raise FrameError(f"{device}: there is no such camera; plug it in or correct `source`")
        super().__init__(
            str(device),
            lambda: open_v4l2(str(device), camera),
            clock=clock,
            stamp=driver_stamp_ns,
        )


class RtspFrames(LiveFrames):
    """`rtsp://…`: a network camera, stamped on arrival (its delay is the camera's time offset)."""

    def __init__(self, url: str, _camera: CameraConfig, *, clock: Clock) -> None:
        super().__init__(
            without_password(url), lambda: open_rtsp(url), clock=clock, stamp=arrival_ns
        )


def open_v4l2(device: str, camera: CameraConfig) -> Capture:
    """Open a Video4Linux camera; raise FrameError."""
    capture = cv2.VideoCapture(device, cv2.CAP_V4L2)
    if not capture.isOpened():
        raise FrameError(f"{device}: the camera cannot be opened; does another program use it?")
    capture.set(cv2.CAP_PROP_FRAME_WIDTH, camera.width)
    capture.set(cv2.CAP_PROP_FRAME_HEIGHT, camera.height)
    capture.set(cv2.CAP_PROP_FPS, camera.rate)
    capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
    return capture


def open_rtsp(url: str) -> Capture:
    """Open a network stream within a time limit; raise FrameError."""
    limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, _TIMEOUT_MS, cv2.CAP_PROP_READ_TIMEOUT_MSEC]
    capture = cv2.VideoCapture(url, cv2.CAP_FFMPEG, [*limits, _TIMEOUT_MS])
    if not capture.isOpened():
        name = without_password(url)
        raise FrameError(f"{name}: the stream cannot be opened; check address and network")
    return capture


def arrival_ns(_capture: Capture, clock: Clock) -> int:
    """Now, as Unix time."""
    return clock.now_ns()


def driver_stamp_ns(capture: Capture, clock: Clock) -> int:
    """The driver's time stamp as Unix time; now, where the driver gives none that can be true.

    Video4Linux stamps on the monotonic clock, in ms as OpenCV hands it out.
    """
    age_ns = clock.elapsed_ns() - to_ns(capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3)
    return clock.now_ns() - (age_ns if 0 <= age_ns <= _OLDEST_NS else 0)


def without_password(url: str) -> str:
    """The URL without what logs must not hold."""
    scheme, separator, rest = url.partition("://")
    authority, slash, path = rest.partition("/")
    return scheme + separator + authority.rpartition("@")[2] + slash + path
