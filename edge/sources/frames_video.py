"""`file://VIDEO`: a video by PyAV and FFmpeg, by its presentation times."""

import logging
import threading
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import av
import av.error
import numpy as np
from av.logging import set_level

from trigpoint.base.clock import NANOSECONDS, Clock, to_ns, to_seconds
from trigpoint.base.errors import InputError
from trigpoint.geometry import CameraModel
from trigpoint.site.config import CameraConfig

from .frames import Frame, Unreadable, local_path

_log = logging.getLogger(__name__)

_USUAL_RATE = 30.0
_NO_VIDEO = "{}: this is no video that can be read; check the file"


class VideoFrames:
    """A video as if it were being filmed now: its first picture is of the moment of opening."""

    def __init__(self, url: str, _camera: CameraConfig, *, clock: Clock) -> None:
        """Raises InputError for a missing file or one that is no video."""
        self._name = local_path(url)
        self._video = Video(self._name)
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

    def frames(self, stopping: threading.Event) -> Iterator[Frame | Unreadable]:
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
            if picture is None:
                yield Unreadable(f"{self._name}: a picture of this video is damaged")
            else:
                yield Frame(picture, start_ns + position_ns)

    def close(self) -> None:
        self._video.close()


class Video:
    """An open video file, read picture by picture."""

    def __init__(self, file: Path) -> None:
        """Raises InputError for a missing file or one that is no video."""
        if not file.is_file():
            if file.is_dir():
                raise InputError(f"{file}: this is a folder; write dir:// for pictures in one")
            what = "this is no file, so no video" if file.exists() else "there is no such video"
            raise InputError(f"{file}: {what}; check the path")
        set_level(None)
        try:
            self._container = av.open(str(file), metadata_errors="ignore")
        except (av.error.FFmpegError, ValueError):
            raise InputError(_NO_VIDEO.format(file)) from None
        frames = self._decoded() if self._container.streams.video else iter(())
        begin: list[av.VideoFrame | None] = []
        for first in frames:
            begin.append(first)
            if first is not None:
                break
        else:
            self._container.close()
            raise InputError(_NO_VIDEO.format(file))
        rate = float(self._container.streams.video[0].average_rate or 0.0)
        self.rate = rate if 0.1 < rate < 1000 else _USUAL_RATE
        self._frames = chain(begin, frames)
        self._index, self._last_ns, self._start_ns = -1, -1, _time_ns(first)
        self._frame: av.VideoFrame | None = None

    def advance(self) -> int | None:
        """Go to the next picture; its time since the first one, ns, or None at the end.

        Its presentation time where that rises, else the count of pictures at the video's rate;
        where it cannot be decoded, the time of the one before.
        """
        try:
            self._frame = next(self._frames)
        except StopIteration:
            self._frame = None
            return None
        self._index += 1
        if self._frame is None:
            return max(0, self._last_ns)
        position_ns = to_ns(self._index / self.rate)
        time_ns = _time_ns(self._frame)
        if time_ns is not None and self._start_ns is not None:
            position_ns = time_ns - self._start_ns
        if position_ns <= self._last_ns:
            position_ns = max(to_ns(self._index / self.rate), self._last_ns + 1)
        self._last_ns = position_ns
        return position_ns

    def picture(self) -> np.ndarray | None:
        """The picture that `advance` came to, (height, width, 3) BGR; None where it is damaged."""
        if self._frame is None or self._frame.is_corrupt:
            return None
        return self._frame.to_ndarray(format="bgr24")

    def close(self) -> None:
        self._container.close()

    def _decoded(self) -> Iterator[av.VideoFrame | None]:
        """Every picture; None: it cannot be decoded."""
        try:
            for packet in self._container.demux(video=0):
                try:
                    frames = packet.decode()
                except av.error.InvalidDataError:
                    yield None
                    continue
                yield from (frame for frame in frames if isinstance(frame, av.VideoFrame))
        except av.error.FFmpegError as reason:
            _log.warning("the video breaks off here (%s)", reason.strerror)


def _time_ns(frame: av.VideoFrame) -> int | None:
    if frame.pts is None or frame.time_base is None:
        return None
    return round(frame.pts * frame.time_base * NANOSECONDS)
