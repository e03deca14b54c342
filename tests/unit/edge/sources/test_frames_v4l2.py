"""Cameras of this machine: their controls, and what the kernel's stamps mean."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from trigpoint.base.clock import Clock, ManualClock, to_ns
from trigpoint.base.errors import FrameError, InputError
from trigpoint.edge.sources import frames_v4l2
from trigpoint.edge.sources.frames import Stamp
from trigpoint.edge.sources.frames_v4l2 import Options, fourcc, kernel_stamp, parse_url
from trigpoint.site.config import CameraConfig

NOW = to_ns(1e9)


class FakeVideoCapture:
    """cv2.VideoCapture as far as it is used; `lacks`: controls that the camera has not."""

    lacks: frozenset[int] = frozenset()
    opens = True
    last: "FakeVideoCapture"

    def __init__(self, *_device: object) -> None:
        self.values: dict[int, float] = {}
        self.is_released = False
        type(self).last = self

    def isOpened(self) -> bool:
        return self.opens

    def set(self, control: int, value: float) -> bool:
        if control in self.lacks:
            return False
        self.values[control] = value
        return True

    def get(self, propId: int) -> float:  # noqa: N803
        return self.values.get(propId, 0.0)

    def read(self) -> tuple[bool, np.ndarray]:
        return True, np.zeros((4, 4), np.uint8)

    def release(self) -> None:
        self.is_released = True


@pytest.fixture(autouse=True)
def fake(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cv2, "VideoCapture", FakeVideoCapture)
    monkeypatch.setattr(FakeVideoCapture, "lacks", frozenset())
    monkeypatch.setattr(FakeVideoCapture, "opens", True)


def opened(options: Options) -> dict[int, float]:
    camera = CameraConfig("v4l2://0", width=800, height=600, rate=15.0)
    frames_v4l2._open("/dev/video0", camera, options)
    return FakeVideoCapture.last.values


def test_size_and_rate_are_asked_for_and_autofocus_is_off() -> None:
    values = opened(Options())
    assert values[cv2.CAP_PROP_FRAME_WIDTH] == 800
    assert values[cv2.CAP_PROP_FRAME_HEIGHT] == 600
    assert values[cv2.CAP_PROP_FPS] == 15
    assert values[cv2.CAP_PROP_AUTOFOCUS] == 0
    assert cv2.CAP_PROP_EXPOSURE not in values


def test_options_fix_exposure_focus_gain_and_format() -> None:
    values = opened(Options(exposure_ms=8.0, gain=20.0, focus=30.0, format="MJPG"))
    assert values[cv2.CAP_PROP_AUTO_EXPOSURE] == 1
    assert values[cv2.CAP_PROP_EXPOSURE] == 80
    assert values[cv2.CAP_PROP_GAIN] == 20
    assert values[cv2.CAP_PROP_FOCUS] == 30
    assert values[cv2.CAP_PROP_FOURCC] == cv2.VideoWriter.fourcc(*"MJPG") == fourcc("MJPG")


def test_option_that_the_camera_does_not_have_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FakeVideoCapture, "lacks", frozenset([cv2.CAP_PROP_FOCUS]))
    with pytest.raises(InputError, match="/dev/video0: this camera does not take focus"):
        opened(Options(focus=3.0))
    assert FakeVideoCapture.last.is_released
    opened(Options())


def test_camera_in_use_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FakeVideoCapture, "opens", False)
    with pytest.raises(FrameError, match="does another program use it"):
        opened(Options())


def test_url_names_device_and_options() -> None:
    device, options = parse_url("v4l2:///dev/video2?exposure_ms=8&focus=30&gain=1&format=MJPG")
    assert device == Path("/dev/video2")
    assert options == Options(exposure_ms=8.0, gain=1.0, focus=30.0, format="MJPG")
    assert parse_url("v4l2://1") == (Path("/dev/video1"), Options())


@pytest.mark.parametrize(
    ("query", "said"),
    [
        ("exposure=8", "no option «exposure»; did you mean «exposure_ms»"),
        ("zoom=8", "no option «zoom»; it takes exposure_ms, gain, focus, format"),
        ("exposure_ms=fast", "exposure_ms is «fast»"),
        ("exposure_ms=0", "exposure_ms is «0»"),
        ("gain=nan", "gain is «nan»"),
        ("format=JPEG2000", "four letters"),
    ],
)
def test_option_that_is_none_is_named(query: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        parse_url(f"v4l2:///dev/video0?{query}")


class TwoClocks(ManualClock):
    """A machine that booted 100 s ago."""

    def elapsed_ns(self) -> int:
        return to_ns(100.0)


@pytest.mark.parametrize(
    ("driver_s", "age_s", "how"),
    [
        (99.95, 0.05, Stamp.MONOTONIC),
        (1e9 - 0.125, 0.125, Stamp.REALTIME),
        (0.0, 0.0, Stamp.ARRIVAL),
        (100.5, 0.0, Stamp.ARRIVAL),
        (90.0, 0.0, Stamp.ARRIVAL),
        (1e9 - 5.0, 0.0, Stamp.ARRIVAL),
    ],
)
def test_kernels_stamp_counts_where_it_can_be_true(
    driver_s: float, age_s: float, how: Stamp
) -> None:
    clock: Clock = TwoClocks(NOW)
    capture = FakeVideoCapture()
    capture.set(cv2.CAP_PROP_POS_MSEC, driver_s * 1e3)
    captured_ns, stamp = kernel_stamp(0.0)(capture, clock)
    assert stamp is how
    assert abs(captured_ns - (NOW - to_ns(age_s))) < 1000  # OpenCV hands it out as a float


def test_stamp_is_the_middle_of_an_exposure_that_is_known() -> None:
    capture = FakeVideoCapture()
    capture.set(cv2.CAP_PROP_POS_MSEC, 99_950.0)
    captured_ns, _ = kernel_stamp(20.0)(capture, TwoClocks(NOW))
    assert captured_ns == NOW - to_ns(0.05) - to_ns(0.01)


@pytest.mark.parametrize(("driver_s", "later_ms"), [(99.95, -50 + 15), (0.0, -15)])
def test_stamp_of_a_rolling_shutter_is_its_middle_rows(driver_s: float, later_ms: float) -> None:
    capture = FakeVideoCapture()
    capture.set(cv2.CAP_PROP_POS_MSEC, driver_s * 1e3)
    captured_ns, _ = kernel_stamp(20.0, readout_s=0.03)(capture, TwoClocks(NOW))
    assert abs(captured_ns - (NOW - to_ns(0.01) + to_ns(later_ms / 1e3))) < 1000


@pytest.mark.parametrize(("letters", "is_whole"), [("Y16", True), ("MJPG", False), ("YUYV", False)])
def test_camera_of_sixteen_bits_gives_all_of_them(letters: str, is_whole: bool) -> None:
    values = opened(parse_url(f"v4l2://0?format={letters}")[1])
    assert (values.get(cv2.CAP_PROP_CONVERT_RGB) == 0) is is_whole
