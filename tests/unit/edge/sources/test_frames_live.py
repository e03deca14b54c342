"""Cameras that do not wait: the newest picture wins, and what is lost is told."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from support.builders import eventually

from trigpoint.base.clock import Clock, ManualClock, SystemClock, to_ns
from trigpoint.base.errors import FrameError, InputError
from trigpoint.edge.sources.frames import Frame, Unreadable, open_source, without_password
from trigpoint.edge.sources.frames_live import STALLED_S, Capture, LiveFrames, _Pace, arrival_stamp
from trigpoint.site.config import CameraConfig


class FakeCapture:
    """A capture that gives a picture for each permit; out of permits it waits, at the end it is
    lost. `picture` makes the next one by its number."""

    def __init__(self, picture: Callable[[int], int] = lambda number: number) -> None:
        self.permits = threading.Semaphore(0)
        self.made = 0
        self.is_lost = threading.Event()
        self.is_released = threading.Event()
        self._picture = picture

    def read(self) -> tuple[bool, np.ndarray]:
        while not self.permits.acquire(timeout=0.01):
            if self.is_lost.is_set() or self.is_released.is_set():
                return False, np.zeros((0, 0))
        self.made += 1
        return True, np.full((4, 4), self._picture(self.made), np.uint8)

    def get(self, propId: int) -> float:  # noqa: N803
        return 0.0

    def release(self) -> None:
        self.is_released.set()


class SteppedClock(ManualClock):
    """A clock that a test sets; several threads read it."""

    def set(self, seconds: float) -> None:
        self._now_ns = to_ns(seconds)


def pictures(found: Iterator[Frame | Unreadable]) -> Iterator[Frame]:
    """Those that can be read."""
    return (frame for frame in found if isinstance(frame, Frame))


@contextmanager
def live(
    capture: FakeCapture, *, rate: float = 1e6, clock: Clock | None = None
) -> Iterator[tuple[LiveFrames, Iterator[Frame], threading.Event]]:
    stopping = threading.Event()
    source = LiveFrames(
        "cam",
        lambda: capture,
        clock=clock or SystemClock(),
        rate=rate,
        stamp=arrival_stamp,
    )
    try:
        yield source, pictures(source.frames(stopping)), stopping
    finally:
        stopping.set()
        capture.is_lost.set()
        source.close()


class DamagedCapture(FakeCapture):
    """Every second picture is damaged, and all after the fifth."""

    def read(self) -> tuple[bool, np.ndarray]:
        is_read, picture = super().read()
        is_damaged = self.made % 2 == 0 or self.made > 5
        return is_read, np.zeros((0, 0)) if is_damaged else picture


@pytest.mark.parametrize(
    ("sound", "missing"),
    [
        ((True, False, True, False, True, False, False), "no whole picture for 2 s"),
        ((True, False, True), "no picture for 2 s"),  # nothing comes behind a whole one
    ],
)
def test_damaged_pictures_are_counted_and_named_where_no_other_comes(
    sound: tuple[bool, ...], missing: str
) -> None:
    capture, clock = DamagedCapture(), ManualClock()
    source = LiveFrames("cam", lambda: capture, clock=clock, rate=1e6, stamp=arrival_stamp)
    found = source.frames(threading.Event())
    try:
        for is_sound in sound:
            capture.permits.release()
            assert isinstance(next(found), Frame) == is_sound
        clock.advance(3 * STALLED_S)
        with pytest.raises(FrameError, match=f"cam: {missing}"):
            next(found)
    finally:
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

    source = LiveFrames("cam", refuse, clock=SystemClock(), rate=10.0, stamp=arrival_stamp)
    with pytest.raises(FrameError, match="in use"):
        next(iter(source.frames(threading.Event())))
    source.close()


def test_what_cannot_be_is_told_as_it_was_raised() -> None:
    def refuse() -> Capture:
        raise InputError("cam: no such control")

    source = LiveFrames("cam", refuse, clock=SystemClock(), rate=10.0, stamp=arrival_stamp)
    with pytest.raises(InputError, match="no such control"):
        next(iter(source.frames(threading.Event())))
    source.close()


@pytest.mark.parametrize(("camera_rate", "let_through"), [(30, 30), (10, 30), (12, 30), (5, 15)])
def test_rate_is_kept_on_average(camera_rate: int, let_through: int) -> None:
    pace = _Pace(10.0)
    stamps = [number / camera_rate + 1e-4 * (number % 3) for number in range(3 * camera_rate)]
    due = [pace.is_due(to_ns(1000.0 + stamp)) for stamp in stamps]
    assert abs(sum(due) - let_through) <= 1


def test_pictures_beyond_the_rate_are_passed_over_and_counted() -> None:
    capture, clock = FakeCapture(), SteppedClock(to_ns(1000.0))
    with live(capture, rate=10.0, clock=clock) as (source, frames, _):
        for number in range(7):
            clock.set(1000.0 + number / 30)
            capture.permits.release()
            assert eventually(lambda number=number: capture.made == number + 1)
            if number % 3 == 0:
                frame = next(frames)
                assert (int(frame.picture[0, 0]), frame.passed_over) == (number + 1, min(number, 2))
        assert source.skipped == 0


def test_clock_that_is_set_back_stops_no_camera() -> None:
    capture, clock = FakeCapture(), SteppedClock(to_ns(1000.0))
    with live(capture, rate=10.0, clock=clock) as (_, frames, _):
        for seconds in (1000.0, 1000.1, 900.0):
            clock.set(seconds)
            capture.permits.release()
            assert next(frames).captured_ns == to_ns(seconds)


def test_camera_without_a_new_picture_for_two_seconds_is_lost_whatever_its_driver_says() -> None:
    capture, clock = FakeCapture(), SteppedClock(to_ns(1000.0))
    with live(capture, clock=clock) as (_, frames, _):
        capture.permits.release()
        next(frames)
        clock.set(1004.5)  # two seconds, and two more for a camera that has just been opened
        with pytest.raises(FrameError, match="cam: no picture for 2 s; check the camera"):
            next(frames)


def test_camera_that_never_gives_a_picture_is_lost_too() -> None:
    capture, clock = FakeCapture(), SteppedClock(to_ns(1000.0))
    with live(capture, clock=clock) as (_, frames, _):
        clock.set(1100.0)
        with pytest.raises(FrameError, match="no picture"):
            next(frames)


def test_same_picture_again_is_not_handed_out_and_soon_flagged_as_frozen() -> None:
    capture, clock = FakeCapture(lambda number: min(number, 2)), SteppedClock(to_ns(1000.0))
    with live(capture, rate=10.0, clock=clock) as (_, frames, _):
        found = []
        for number in range(40):
            clock.set(1000.0 + number / 10)
            capture.permits.release()
            assert eventually(lambda number=number: capture.made == number + 1)
            if number < 2 or number > 21:
                found.append(next(frames))
        assert [frame.is_frozen for frame in found] == [False] * 2 + [True] * 18
        assert found[2].passed_over == 20


def test_driver_that_hangs_is_not_opened_a_second_time() -> None:
    may_return = threading.Event()

    def hang() -> Capture:
        may_return.wait(60.0)
        raise FrameError("cam: gone")

    source = LiveFrames("cam", hang, clock=SystemClock(), rate=10.0, stamp=arrival_stamp)
    try:
        with pytest.raises(FrameError, match="cam: its driver hangs"):
            LiveFrames("cam", hang, clock=SystemClock(), rate=10.0, stamp=arrival_stamp)
    finally:
        may_return.set()
        source.close()


@pytest.mark.parametrize("url", ["v4l2:///dev/video-none", "v4l2://99"])
def test_camera_that_is_not_there_is_named(url: str) -> None:
    with pytest.raises(FrameError, match=r"/dev/video.*: there is no such camera"):
        open_source(url, CameraConfig(url), clock=SystemClock(), directory=Path())


def test_stream_that_nobody_serves_is_told_without_the_password(free_port) -> None:
    url = f"rtsp://user:secret@127.0.0.1:{free_port()}/cam"
    source = open_source(url, CameraConfig(url), clock=SystemClock(), directory=Path())
    with pytest.raises(FrameError, match="cannot be opened") as caught:
        next(iter(source.frames(threading.Event())))
    source.close()
    assert "secret" not in str(caught.value)


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
