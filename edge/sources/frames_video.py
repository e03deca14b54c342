"""`file://VIDEO`: a video by OpenCV and FFmpeg, at its own rate."""

import threading
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from trigpoint.clock import Clock, to_ns, to_seconds
from trigpoint.config import CameraConfig
from trigpoint.errors import InputError
from trigpoint.geometry import CameraModel

from .frames import Frame, local_path

_USUAL_RATE = 30.0


class VideoFrames:
    """A video as if it were being filmed now: its first picture is of the moment of opening."""

    def __init__(self, url: str, _camera: CameraConfig, *, clock: Clock) -> None:
        """Raises InputError for a missing file or one that is no video."""
        self._video = Video(local_path(url))
        self._clock = clock
        self._skipped = 0

    @property
    def intrinsics(self) -> CameraModel | None:
        """Videos do not tell."""
        return None

    @property
    def skipped(self) -> int:
        """How many pictures were over before the taker came."""
        return self._skipped

    def frames(self, stopping: threading.Event) -> Iterator[Frame]:
        """Pictures until the video's end, each at its own time."""
        start_ns, started_ns = self._clock.now_ns(), self._clock.elapsed_ns()
        period_ns = to_ns(1 / self._video.rate)
        while (position_ns := self._video.advance()) is not None:
            early_ns = started_ns + position_ns - self._clock.elapsed_ns()
            if early_ns < -period_ns:
                self._skipped += 1
                continue
            if self._clock.wait(stopping, max(0.0, to_seconds(early_ns))):
                return
            picture = self._video.picture()
            if picture is not None:
                yield Frame(picture, start_ns + position_ns)

    def close(self) -> None:
        self._video.close()


class Video:
    """An open video file, read picture by picture."""

    def __init__(self, file: Path) -> None:
        """Raises InputError for a missing file or one that is no video."""
        if not file.is_file():
            raise InputError(f"{file}: there is no such video; check the path")
        self._capture = cv2.VideoCapture(str(file), cv2.CAP_FFMPEG)
        if not self._capture.isOpened() or not self._capture.grab():
            self._capture.release()
            raise InputError(f"{file}: this is no video that can be read; check the file")
        self._is_ahead = True
        rate = self._capture.get(cv2.CAP_PROP_FPS)
        self.rate = rate if np.isfinite(rate) and 0.1 < rate < 1000 else _USUAL_RATE
        self._index = -1
        self._first_ms: float | None = None
        self._last_ns = -1

    def advance(self) -> int | None:
        """Go to the next picture; its time since the first one, ns, or None at the end.

        The container's time stamp where it rises, else the count of pictures at the video's rate.
        """
        if not self._is_ahead and not self._capture.grab():
            return None
        self._is_ahead = False
        self._index += 1
        stamp_ms = self._capture.get(cv2.CAP_PROP_POS_MSEC)
        if self._first_ms is None:
            self._first_ms = stamp_ms
        position_ns = to_ns((stamp_ms - self._first_ms) / 1e3)
        if position_ns <= self._last_ns:
            position_ns = max(to_ns(self._index / self.rate), self._last_ns + 1)
        self._last_ns = position_ns
        return position_ns

    def picture(self) -> np.ndarray | None:
        """The picture that `advance` came to, (height, width, 3) BGR; None where it is damaged."""
        is_read, picture = self._capture.retrieve()
        return picture if is_read else None

    def close(self) -> None:
        self._capture.release()
