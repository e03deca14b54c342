"""`rtsp://…`: a network camera, by OpenCV and FFmpeg."""

import cv2

from trigpoint.clock import Clock
from trigpoint.config import CameraConfig
from trigpoint.errors import FrameError

from .frames_live import STALLED_S, Capture, LiveFrames, arrival_stamp

_OPEN_TIMEOUT_MS = 5000


class RtspFrames(LiveFrames):
    """A stream, stamped on arrival: its delay is the camera's time offset, which fusion estimates
    where `time_offset_sigma` is above 0."""

    def __init__(self, url: str, camera: CameraConfig, *, clock: Clock) -> None:
        super().__init__(
            without_password(url),
            lambda: _open(url),
            clock=clock,
            rate=camera.rate,
            stamp=arrival_stamp,
        )


def _open(url: str) -> Capture:
    """Open a network stream within a time limit; raise FrameError."""
    limits = {
        cv2.CAP_PROP_OPEN_TIMEOUT_MSEC: _OPEN_TIMEOUT_MS,
        cv2.CAP_PROP_READ_TIMEOUT_MSEC: round(STALLED_S * 1e3),
    }
    settings = [number for pair in limits.items() for number in pair]
    capture = cv2.VideoCapture(url, cv2.CAP_FFMPEG, settings)
    if not capture.isOpened():
        name = without_password(url)
        raise FrameError(f"{name}: the stream cannot be opened; check address and network")
    return capture


def without_password(url: str) -> str:
    """The URL without what logs must not hold."""
    scheme, separator, rest = url.partition("://")
    authority, slash, path = rest.partition("/")
    return scheme + separator + authority.rpartition("@")[2] + slash + path
