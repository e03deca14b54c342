"""Cameras that do not wait: what `v4l2://` and `rtsp://` have in common.

A thread of the source's own reads on and keeps the newest picture alone, since drivers and network
streams queue: whoever reads slowly would see the past.
"""

import threading
from collections.abc import Callable, Iterator
from typing import Protocol

import numpy as np
from msgspec.structs import replace

from trigpoint.base.clock import Clock, to_ns
from trigpoint.base.errors import FrameError, TrigpointError
from trigpoint.geometry import CameraModel

from .frames import Frame, Stamp, Unreadable

STALLED_S = 2.0
"""A camera without a new picture for so long is lost, whatever its driver says."""
FROZEN_S = 2.0
_OPENING_S = 10.0
_PERIODS = 3.0
_LOOK_S = 0.2
_JOIN_S = 0.5
_JITTER_NS = 500_000


class Capture(Protocol):
    """What is needed of cv2.VideoCapture; an empty picture is one that cannot be read."""

    def read(self) -> tuple[bool, np.ndarray]: ...

    def get(self, propId: int) -> float: ...  # noqa: N803 - OpenCV's name

    def release(self) -> None: ...


class LiveFrames:
    """The newest picture of a capture that a thread reads; opened on that thread too, since it can
    take seconds. `stamp`: capture and clock to the Unix time of a picture that was just read, and
    how it is known; `rate`: pictures a second at most."""

    def __init__(
        self,
        name: str,
        open_capture: Callable[[], Capture],
        *,
        clock: Clock,
        rate: float,
        stamp: Callable[[Capture, Clock], tuple[int, Stamp]],
    ) -> None:
        """Raises FrameError while the thread of an earlier opening hangs in the driver."""
        self._name, self._clock, self._stamp = name, clock, stamp
        self._pace = _Pace(rate)
        self._stalled_ns = to_ns(max(STALLED_S, _PERIODS / rate))
        self._changed = threading.Condition()
        self._newest: Frame | None = None
        self._lost: TrigpointError | None = None
        self._skipped = self._passed_over = self._damaged = 0
        self._is_damaged = False
        self._closing = threading.Event()
        self._alive_ns = clock.elapsed_ns() + to_ns(_OPENING_S)
        self._last: np.ndarray | None = None
        self._fresh_ns = 0
        title = f"reads {name}"
        if any(thread.name == title for thread in threading.enumerate()):
            raise FrameError(f"{name}: its driver hangs since it was lost; unplug the camera")
        self._thread = threading.Thread(
            target=self._read, args=(open_capture,), name=title, daemon=True
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

    def frames(self, stopping: threading.Event) -> Iterator[Frame | Unreadable]:
        """The newest picture each time; raises FrameError when the camera is lost or stalls."""
        damaged = 0
        while not stopping.is_set():
            frame = self._take()
            while damaged < self._damaged:
                damaged += 1
                yield Unreadable(f"{self._name}: a picture came damaged")
            if frame is not None:
                yield frame
            elif self._clock.elapsed_ns() > self._alive_ns + self._stalled_ns:
                waited_s = self._stalled_ns / 1e9
                kind = "whole picture" if self._is_damaged else "picture"
                raise FrameError(f"{self._name}: no {kind} for {waited_s:.0f} s; check the camera")

    def close(self) -> None:
        """Stop reading. A read that hangs in the driver ends by its own time limit."""
        self._closing.set()
        self._thread.join(_JOIN_S)

    def _take(self) -> Frame | None:
        """Wait a moment for a picture. Raises where there will be none."""
        with self._changed:
            self._changed.wait_for(lambda: self._newest is not None or self._lost, _LOOK_S)
            frame, self._newest = self._newest, None
            if frame is None and self._lost is not None:
                raise self._lost
            return frame

    def _read(self, open_capture: Callable[[], Capture]) -> None:
        try:
            capture = open_capture()
            self._alive_ns = self._clock.elapsed_ns() + to_ns(STALLED_S)  # cameras start slowly
            try:
                while not self._closing.is_set():
                    self._keep(capture)
            finally:
                capture.release()
        except TrigpointError as reason:
            with self._changed:
                self._lost = reason
                self._changed.notify_all()

    def _keep(self, capture: Capture) -> None:
        is_read, picture = capture.read()
        if not is_read:
            raise FrameError(f"{self._name}: the camera was lost; check its cable or network")
        self._is_damaged = not picture.size
        if self._is_damaged:
            self._damaged += 1
            return
        captured_ns, stamp = self._stamp(capture, self._clock)
        self._alive_ns = max(self._alive_ns, self._clock.elapsed_ns())
        is_new, is_frozen = self._compare(picture)
        if not (is_new or is_frozen) or not self._pace.is_due(captured_ns):
            self._passed_over += 1
            return
        frame = Frame(picture, captured_ns, stamp, self._passed_over, is_frozen)
        self._passed_over = 0
        with self._changed:
            if self._newest is not None:
                self._skipped += 1
                frame = replace(frame, passed_over=frame.passed_over + self._newest.passed_over)
            self._newest = frame
            self._changed.notify_all()

    def _compare(self, picture: np.ndarray) -> tuple[bool, bool]:
        """Whether the picture is another than the last, and whether none has been for too long.

        Two pictures of a sensor never are the same: each has its own noise.
        """
        now_ns = self._clock.elapsed_ns()
        if self._last is None or not np.array_equal(picture, self._last):
            self._last, self._fresh_ns = picture, now_ns
            return True, False
        return False, now_ns - self._fresh_ns > to_ns(FROZEN_S)


class _Pace:
    """Lets pictures through at a rate, on average: one that comes late makes none later."""

    def __init__(self, rate: float) -> None:
        self._period_ns = to_ns(1 / rate)
        self._due_ns = 0

    def is_due(self, captured_ns: int) -> bool:
        early_ns = self._due_ns - captured_ns
        # Stamps jitter around a camera's own rate, which may be just this one. One that lies far
        # before the last is of a clock that was set back.
        if _JITTER_NS < early_ns <= self._period_ns:
            return False
        is_in_step = -self._period_ns < early_ns <= self._period_ns
        self._due_ns = (self._due_ns if is_in_step else captured_ns) + self._period_ns
        return True


def arrival_stamp(_capture: Capture, clock: Clock) -> tuple[int, Stamp]:
    """Now, as Unix time."""
    return clock.now_ns(), Stamp.ARRIVAL
