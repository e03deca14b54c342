"""A source of pictures of one's own: a camera that gives its newest picture over HTTP.

Say so in your package's pyproject.toml, and any site file may have `source = "snapshot://…"`:

    [project.entry-points."trigpoint.frames"]
    snapshot = "camera_source:SnapshotFrames"
"""

import threading
import urllib.request
from collections.abc import Iterator

import cv2
import numpy as np

from trigpoint import plugins


class SnapshotFrames:
    """`snapshot://camera.local/image.jpg`, asked for at the rate of the site file."""

    intrinsics = None  # the site file has them
    skipped = 0

    def __init__(self, url: str, camera: plugins.CameraConfig, *, clock: plugins.Clock) -> None:
        self._url = url.replace("snapshot://", "http://", 1)
        self._period_s, self._clock = 1 / camera.rate, clock

    def frames(self, stopping: threading.Event) -> Iterator[plugins.Frame]:
        while not stopping.is_set():
            asked_ns = self._clock.now_ns()
            picture = self._picture()
            taken_ns = (asked_ns + self._clock.now_ns()) // 2
            yield plugins.Frame(picture, taken_ns, plugins.Stamp.ARRIVAL)
            self._clock.wait(stopping, self._period_s)

    def _picture(self) -> np.ndarray:
        try:
            with urllib.request.urlopen(self._url, timeout=2) as answer:
                picture = cv2.imdecode(np.frombuffer(answer.read(), np.uint8), cv2.IMREAD_GRAYSCALE)
        except OSError as reason:
            raise plugins.FrameError(f"{self._url}: {reason}; is the camera on?") from None
        if picture is None:
            raise plugins.FrameError(f"{self._url}: no picture came; check the path")
        return picture

    def close(self) -> None:
        """Nothing is held open."""
