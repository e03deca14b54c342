"""`rtsp://…`: a network camera, by PyAV and FFmpeg."""

import struct
from collections.abc import Iterator

import av
import av.error
import numpy as np
from av.container import InputContainer
from av.logging import set_level

from trigpoint.base.clock import Clock
from trigpoint.base.errors import FrameError
from trigpoint.site.config import CameraConfig

from .frames import Stamp, without_password
from .frames_live import STALLED_S, Capture, LiveFrames
from .stream_clock import Arrival, StreamClock

_OPEN_TIMEOUT_S = 5.0
# TCP loses no part of a picture. FFmpeg buffers, reorders and probes for people's eyes otherwise.
_OPTIONS = {
    "rtsp_flags": "prefer_tcp",
    "fflags": "nobuffer+discardcorrupt",
    "flags": "low_delay",
    "max_delay": "0",
    "reorder_queue_size": "0",
    "analyzeduration": "500000",
    "probesize": "65536",
}
# AVProducerReferenceTime: the sender's Unix time in microseconds, flags, padding.
_REFERENCE = struct.Struct("<qi4x")
_REMEMBERED = 64
_WAYS_NS: dict[str, int] = {}
"""How long each stream's way took when it was open last: no picture after a break is stamped
otherwise than those before."""


class RtspFrames(LiveFrames):
    """A stream, stamped by its presentation times: on the sender's clock where it tells that and it
    is set, else as they arrive, and what is left of the way is the camera's time offset, which
    fusion estimates (`time_offset_sigma`)."""

    def __init__(self, url: str, camera: CameraConfig, *, clock: Clock) -> None:
        super().__init__(
            without_password(url),
            lambda: Stream(url, clock),
            clock=clock,
            rate=camera.rate,
            stamp=_stamp_of,
        )


def _stamp_of(capture: Capture, _clock: Clock) -> tuple[int, Stamp]:
    assert isinstance(capture, Stream)  # it is what was opened above
    return capture.captured


class Stream:
    """An open stream, read by one thread. `captured`: when the last picture was taken."""

    def __init__(self, url: str, clock: Clock) -> None:
        """Raises FrameError within a time limit."""
        self._name, self._clock = without_password(url), clock
        set_level(None)
        self._container = _open(url, self._name)
        video = self._container.streams.video[0]
        video.codec_context.thread_count = 1  # more of them hold a picture back each
        self._times = StreamClock(_WAYS_NS.get(self._name))
        self._arrivals: dict[int, tuple[int, int | None]] = {}
        self._frames = self._decoded()
        self.captured = (0, Stamp.ARRIVAL)

    def read(self) -> tuple[bool, np.ndarray]:
        """The next picture that is of now, empty where it came damaged; false where the stream is
        over."""
        try:
            for frame in self._frames:
                if frame is None:
                    return True, np.zeros((0, 0))
                captured = self._captured(frame)
                if captured is not None:
                    self.captured = captured
                    return True, frame.to_ndarray(format="bgr24")
        except av.error.FFmpegError as reason:
            raise FrameError(f"{self._name}: {_why(reason)}") from None
        return False, np.zeros((0, 0))

    def get(self, propId: int) -> float:  # noqa: N803, ARG002 - OpenCV's
        """Nothing is known by OpenCV's numbers."""
        return 0.0

    def release(self) -> None:
        """Close it."""
        if self._times.way_ns is not None:
            if len(_WAYS_NS) >= _REMEMBERED:
                _WAYS_NS.clear()
            _WAYS_NS[self._name] = self._times.way_ns
        self._container.close()

    def _decoded(self) -> Iterator[av.VideoFrame | None]:
        """Every picture; None: a part of it is missing."""
        for packet in self._container.demux(video=0):
            if packet.pts is not None:
                self._note_arrival(packet.pts, _sender_ns(packet))
            try:
                frames = packet.decode()
            except av.error.InvalidDataError:
                yield None
                continue
            pictures = (frame for frame in frames if isinstance(frame, av.VideoFrame))
            yield from (None if picture.is_corrupt else picture for picture in pictures)

    def _note_arrival(self, pts: int, sender_ns: int | None) -> None:
        """A picture comes in one or more packets, and out some packets later."""
        if pts not in self._arrivals:
            self._arrivals[pts] = (self._clock.elapsed_ns(), sender_ns)
        while len(self._arrivals) > _REMEMBERED:
            del self._arrivals[next(iter(self._arrivals))]

    def _captured(self, frame: av.VideoFrame) -> tuple[int, Stamp] | None:
        now_ns = self._clock.elapsed_ns()
        if frame.pts is None or frame.time_base is None:
            return self._clock.now_ns(), Stamp.ARRIVAL
        arrived_ns, sender_ns = self._arrivals.pop(frame.pts, (now_ns, None))
        presented_ns = round(frame.pts * frame.time_base * 1_000_000_000)
        unix_ns = self._clock.now_ns() - now_ns
        return self._times.stamp(Arrival(presented_ns, arrived_ns, unix_ns, sender_ns))


def _sender_ns(packet: av.Packet) -> int | None:
    """The sender's Unix time of a packet, from RTCP's sender reports; None before the first."""
    for data in packet.iter_sidedata():
        if data.data_type == "prft":
            return _REFERENCE.unpack(bytes(data)[: _REFERENCE.size])[0] * 1000
    return None


def _open(url: str, name: str) -> InputContainer:
    limits = (_OPEN_TIMEOUT_S, STALLED_S)
    try:
        container = av.open(url, options=_OPTIONS, timeout=limits, metadata_errors="ignore")
    except (av.error.FFmpegError, ValueError) as reason:
        why = _why(reason)
        raise FrameError(
            f"{name}: the stream cannot be opened ({why}); check address, password and network"
        ) from None
    if not container.streams.video:
        container.close()
        raise FrameError(f"{name}: the stream has no video; check the address")
    return container


def _why(reason: Exception) -> str:
    """FFmpeg's reason without the address, which may hold a password."""
    if isinstance(reason, av.error.ExitError | av.error.TimeoutError):
        return "no answer in time"
    if isinstance(reason, av.error.HTTPUnauthorizedError):
        return "name or password are refused"
    return str(getattr(reason, "strerror", "") or type(reason).__name__)
