"""Sends a camera's pictures as JPEG: only while somebody listens, and not more than was asked."""

import threading

import cv2
import numpy as np

from trigpoint.base.clock import to_ns
from trigpoint.base.errors import OperationError
from trigpoint.bus.bus import Publisher
from trigpoint.contract.cdr import encode
from trigpoint.contract.messages import Picture
from trigpoint.site.config import CameraConfig

from .sources.frames import Frame


class PictureSender:
    """`keep` and `offer` are called on the camera's thread, `snapshot` on the bus's serving one."""

    def __init__(self, camera: str, config: CameraConfig, publisher: Publisher) -> None:
        self._camera, self._publisher = camera, publisher
        self._quality = config.picture_quality
        self._period_ns = to_ns(1 / config.picture_rate)
        self._due_ns = 0
        self._lock = threading.Lock()
        self._latest: np.ndarray | None = None

    def keep(self, frame: Frame) -> None:
        """Make this the picture that a snapshot shows."""
        with self._lock:
            self._latest = frame.picture

    def offer(self, frame: Frame) -> bool:
        """Send the frame if one is due and wanted; return whether it was sent."""
        if frame.captured_ns < self._due_ns or not self._publisher.has_listener:
            return False
        self._due_ns = max(self._due_ns + self._period_ns, frame.captured_ns)
        data = encode_jpeg(frame.picture, self._quality)
        stamp_ns, frame_id = frame.captured_ns, f"{self._camera}/optical"
        self._publisher.put(encode(Picture(stamp_ns, frame_id, "jpeg", data)))
        return True

    def snapshot(self, _request: bytes) -> bytes:
        """The latest picture as JPEG; raises OperationError before the first one."""
        with self._lock:
            picture = self._latest
        if picture is None:
            raise OperationError(f"camera {self._camera} has given no picture yet; try again")
        return encode_jpeg(picture, self._quality)


def encode_jpeg(picture: np.ndarray, quality: int) -> bytes:
    """The JPEG bytes of a grey or BGR picture; `quality`: 1 to 100."""
    is_encoded, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not is_encoded:
        raise OperationError("a picture could not be made a JPEG")
    return data.tobytes()
