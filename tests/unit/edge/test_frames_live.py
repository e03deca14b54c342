"""Cameras that do not wait: the newest picture wins, and what is lost is told."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from builders import eventually

from trigpoint.clock import Clock, ManualClock, SystemClock, to_ns
from trigpoint.config import CameraConfig
from trigpoint.edge.frames import Frame, open_source
from trigpoint.edge.frames_live import (
    Capture,
    LiveFrames,
    arrival_ns,
    driver_stamp_ns,
    without_password,
)
from trigpoint.errors import FrameError


class FakeCapture:
    """A capture that gives a picture for each permit; out of permits it waits, at the end it is
    lost."""

    def __init__(self) -> None:
        self.permits = threading.Semaphore(0)
        self.made = 0
        self.is_lost = threading.Event()
        self.is_released = threading.Event()

    def read(self) -> tuple[bool, np.ndarray]:
        while not self.permits.acquire(timeout=0.01):
            if self.is_lost.is_set() or self.is_released.is_set():
                return False, np.zeros((0, 0))
        self.made += 1
        return True, np.full((4, 4), self.made, np.uint8)

    def get(self, propId: int) -> float:  # noqa: N803
        return 0.0

    def release(self) -> None:
        self.is_released.set()


@contextmanager
def live(capture: FakeCapture) -> Iterator[tuple[LiveFrames, Iterator[Frame], threading.Event]]:
    stopping = threading.Event()
    source = LiveFrames("cam", lambda: capture, clock=SystemClock(), stamp=arrival_ns)
    try:
        yield source, iter(source.frames(stopping)), stopping
    finally:
        stopping.set()
        capture.is_lost.set()
        source.close()


def test_pictures_come_in_order() -> None:
    capture = FakeCapture()
    with live(capture) as (source, frames, _):
        seen = []
        for _number in range(3):
            capture.permits.release()
            seen.append(int(next(frames).picture[0, 0]))
        assert (seen, source.skipped) == ([1, 2, 3], 0)
    assert capture.is_released.is_set()


def test_slow_taker_gets_the_newest_and_the_others_are_counted() -> None:
    capture = FakeCapture()
    with live(capture) as (source, frames, _):
        capture.permits.release(5)
        assert eventually(lambda: source.skipped == 4)
        assert int(next(frames).picture[0, 0]) == 5


def test_lost_camera_is_told() -> None:
    capture = FakeCapture()
    with live(capture) as (_, frames, _):
        capture.is_lost.set()
        with pytest.raises(FrameError, match="cam: the camera was lost"):
            next(frames)
    assert capture.is_released.is_set()


def test_last_picture_before_the_loss_is_still_served() -> None:
    capture = FakeCapture()
    with live(capture) as (_, frames, _):
        capture.permits.release()
        capture.is_lost.set()
        assert int(next(frames).picture[0, 0]) == 1
        with pytest.raises(FrameError):
            next(frames)


def test_source_ends_when_told() -> None:
    capture = FakeCapture()
    with live(capture) as (_, frames, stopping):
        stopping.set()
        assert next(frames, None) is None


def test_camera_that_cannot_be_opened_is_told() -> None:
    def refuse() -> Capture:
        raise FrameError("cam: in use")

    source = LiveFrames("cam", refuse, clock=SystemClock(), stamp=arrival_ns)
    with pytest.raises(FrameError, match="in use"):
        next(iter(source.frames(threading.Event())))
    source.close()


def test_camera_that_is_not_there_is_named() -> None:
    url = "v4l2:///dev/video-none"
    with pytest.raises(FrameError, match="/dev/video-none: there is no such camera"):
        open_source(url, CameraConfig(url), clock=SystemClock(), directory=Path())


def test_stream_that_nobody_serves_is_told_without_the_password(free_port) -> None:
    url = f"rtsp://user:secret@127.0.0.1:{free_port()}/cam"
    source = open_source(url, CameraConfig(url), clock=SystemClock(), directory=Path())
    with pytest.raises(FrameError, match="cannot be opened") as caught:
        next(iter(source.frames(threading.Event())))
    source.close()
    assert "secret" not in str(caught.value)


class Stamped(FakeCapture):
    def __init__(self, milliseconds: float) -> None:
        super().__init__()
        self._milliseconds = milliseconds

    def get(self, propId: int) -> float:  # noqa: N803
        return self._milliseconds


class TwoClocks(ManualClock):
    """A machine that booted 100 s ago."""

    def elapsed_ns(self) -> int:
        return to_ns(100.0)


@pytest.mark.parametrize(
    ("stamp_ms", "age_s"), [(99_950.0, 0.05), (0.0, 0.0), (100_500.0, 0.0), (90_000.0, 0.0)]
)
def test_drivers_stamp_counts_where_it_can_be_true(stamp_ms: float, age_s: float) -> None:
    clock: Clock = TwoClocks(to_ns(1e9))
    assert driver_stamp_ns(Stamped(stamp_ms), clock) == to_ns(1e9) - to_ns(age_s)


@pytest.mark.parametrize(
    ("url", "shown"),
    [
        ("rtsp://u:p@host:554/a@b", "rtsp://host:554/a@b"),
        ("rtsp://host/a", "rtsp://host/a"),
        ("rtsp://u@host", "rtsp://host"),
    ],
)
def test_password_is_not_shown(url: str, shown: str) -> None:
    assert without_password(url) == shown
