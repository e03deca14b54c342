"""`v4l2:///dev/video0`: a camera of this machine, by Video4Linux.

Options stand behind the device: `v4l2:///dev/video0?exposure_ms=8&focus=30&gain=10&format=MJPG`.
Autofocus is always off: a lens that moves is not the one that was calibrated. An exposure that is
given is fixed, and half of it is taken off the stamps; without one the camera chooses its own.
"""

import os
from collections.abc import Callable
from pathlib import Path

import cv2
from msgspec import Struct

from trigpoint.base.clock import Clock, to_ns
from trigpoint.base.errors import FrameError, InputError
from trigpoint.site.config import CameraConfig

from .frames import Stamp, place_and_options
from .frames_live import STALLED_S, Capture, LiveFrames

_OLDEST_NS = to_ns(2.0)
_LARGEST = 1e6
_MANUAL_EXPOSURE = 1  # V4L2_EXPOSURE_MANUAL
_EXPOSURES_PER_MS = 10  # the control counts 100 µs
_SELECT_TIMEOUT = "OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT"  # seconds; 10 unless told


_DEEP = tuple(int.from_bytes(name, "little") for name in (b"Y16 ", b"Y12 ", b"Y10 "))


class Options(Struct, frozen=True):
    """What a URL says of a camera beyond its device."""

    exposure_ms: float | None = None
    gain: float | None = None
    focus: float | None = None
    format: str | None = None


class V4l2Frames(LiveFrames):
    """A camera, asked for the site file's size and rate, stamped by the kernel."""

    def __init__(self, url: str, camera: CameraConfig, *, clock: Clock) -> None:
        """Raises InputError for an option that is none, FrameError where no such camera is."""
        device, options = parse_url(url)
        if not device.exists():
            raise FrameError(f"{device}: there is no such camera; plug it in or correct `source`")
        os.environ.setdefault(_SELECT_TIMEOUT, str(round(STALLED_S)))
        super().__init__(
            str(device),
            lambda: _open(str(device), camera, options),
            clock=clock,
            rate=camera.rate,
            stamp=kernel_stamp(options.exposure_ms or 0.0, readout_s=camera.readout_s),
        )


def parse_url(url: str) -> tuple[Path, Options]:
    """The device and the options; a bare number n is /dev/videon. Raises InputError."""
    place, words = place_and_options(url, Options.__struct_fields__)
    device = Path(f"/dev/video{place}" if place.isdigit() else place)
    return device, Options(
        exposure_ms=_number(device, words, "exposure_ms"),
        gain=_number(device, words, "gain"),
        focus=_number(device, words, "focus"),
        format=_format(device, words),
    )


def _number(device: Path, words: dict[str, str], key: str) -> float | None:
    if key not in words:
        return None
    try:
        number = float(words[key])
    except ValueError:
        number = -1.0
    if not 0 <= number < _LARGEST or (key == "exposure_ms" and number == 0):
        raise InputError(f"{device}: {key} is «{words[key]}»; give a number like {key}=8")
    return number


def _format(device: Path, words: dict[str, str]) -> str | None:
    value = words.get("format")
    if value is not None and not (2 < len(value) <= 4 and value.isascii()):
        raise InputError(f"{device}: format is «{value}»; give four letters, like format=MJPG")
    return value and value.ljust(4)  # Y16 ends in a blank


def _open(device: str, camera: CameraConfig, options: Options) -> Capture:
    """Open a camera and set it; raise FrameError, and InputError for what it cannot do."""
    capture = cv2.VideoCapture(device, cv2.CAP_V4L2)
    if not capture.isOpened():
        raise FrameError(f"{device}: the camera cannot be opened; does another program use it?")
    try:
        if options.format is not None:
            _demand(capture, device, "format", cv2.CAP_PROP_FOURCC, fourcc(options.format))
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, camera.width)
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, camera.height)
        capture.set(cv2.CAP_PROP_FPS, camera.rate)
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        if int(capture.get(cv2.CAP_PROP_FOURCC)) in _DEEP:
            # OpenCV would keep the upper 8 of 16 bits, of which a sensor of 10 uses two.
            capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)
        _fix_controls(capture, device, options)
    except BaseException:
        capture.release()
        raise
    return capture


def _fix_controls(capture: cv2.VideoCapture, device: str, options: Options) -> None:
    capture.set(cv2.CAP_PROP_AUTOFOCUS, 0)  # a lens of fixed focus has no such control
    if options.focus is not None:
        _demand(capture, device, "focus", cv2.CAP_PROP_FOCUS, options.focus)
    if options.exposure_ms is not None:
        ticks = max(1.0, round(options.exposure_ms * _EXPOSURES_PER_MS))
        capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, _MANUAL_EXPOSURE)  # some have nothing to switch off
        _demand(capture, device, "exposure_ms", cv2.CAP_PROP_EXPOSURE, ticks)
    if options.gain is not None:
        _demand(capture, device, "gain", cv2.CAP_PROP_GAIN, options.gain)


def _demand(capture: cv2.VideoCapture, device: str, name: str, control: int, value: float) -> None:
    if not capture.set(control, value):
        raise InputError(f"{device}: this camera does not take {name}; leave that option out")


def fourcc(letters: str) -> int:
    """The number of a picture format's four letters."""
    return int.from_bytes(letters.encode("ascii"), "little")


def kernel_stamp(
    exposure_ms: float, *, readout_s: float = 0.0
) -> Callable[[Capture, Clock], tuple[int, Stamp]]:
    """A stamp by the driver's: the middle of an exposure that ended when the first data came.

    The kernel stamps USB cameras with the first packet of a picture (uvc_video.c), by its monotonic
    clock or, as a module's parameter says, the real-time one; OpenCV hands it out in ms. Where it
    can be neither, the picture's arrival has to do. A rolling shutter, whose last row is exposed
    `readout_s` after the first, has its middle row's exposure later than the first data's, and
    before the arrival of the last.
    """
    half_ns, to_middle_ns = to_ns(exposure_ms / 2e3), to_ns(readout_s / 2)

    def stamp(capture: Capture, clock: Clock) -> tuple[int, Stamp]:
        driver_ns, now_ns = to_ns(capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3), clock.now_ns()
        age_ns = clock.elapsed_ns() - driver_ns
        if 0 <= age_ns <= _OLDEST_NS:
            return now_ns - age_ns - half_ns + to_middle_ns, Stamp.MONOTONIC
        if 0 <= now_ns - driver_ns <= _OLDEST_NS:
            return driver_ns - half_ns + to_middle_ns, Stamp.REALTIME
        return now_ns - half_ns - to_middle_ns, Stamp.ARRIVAL

    return stamp
