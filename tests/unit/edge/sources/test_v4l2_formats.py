"""What the kernel says of a camera, by a kernel of the test's own."""

import errno
import struct
from pathlib import Path

from trigpoint.edge.checks import described
from trigpoint.edge.sources.v4l2_formats import Offer, offers_of

ENUM_FMT, ENUM_FRAMESIZES, ENUM_FRAMEINTERVALS = 0xC0405602, 0xC02C564A, 0xC034564B
"""As linux/videodev2.h has them on every machine where an int has 32 bits."""


def kernel(_file: int, code: int, request: bytearray) -> int:
    """MJPG at two sizes with rates, YUYV at any size without."""
    index, *more = struct.unpack_from("4I", request)
    formats = [b"MJPG", b"YUYV"]
    if code == ENUM_FMT and index < 2:
        request[44:48] = formats[index]
    elif code == ENUM_FRAMESIZES and more[0].to_bytes(4, "little") == b"MJPG" and index < 2:
        struct.pack_into("3I", request, 8, 1, *[(640, 480), (1280, 720)][index])
    elif code == ENUM_FRAMESIZES and more[0].to_bytes(4, "little") == b"YUYV" and index == 0:
        struct.pack_into("7I", request, 8, 3, 16, 1920, 2, 16, 1080, 2)
    elif code == ENUM_FRAMEINTERVALS and more[0].to_bytes(4, "little") == b"MJPG":
        struct.pack_into("3I", request, 16, 1, 1, 30 if more[1] == 640 else 15)
    else:
        raise OSError(errno.EINVAL, "no more")
    return 0


def test_formats_sizes_and_rates_are_listed(tmp_path: Path) -> None:
    device = tmp_path / "video0"
    device.write_text("")
    offers = offers_of(device, ioctl=kernel)
    assert offers == [
        Offer("MJPG", 640, 480, 30.0),
        Offer("MJPG", 1280, 720, 15.0),
        Offer("YUYV", 1920, 1080, 0.0),
    ]
    assert described(offers) == ("MJPG: 640 × 480 at 30 Hz, 1280 × 720 at 15 Hz; YUYV: 1920 × 1080")


def test_what_is_no_camera_offers_nothing(tmp_path: Path) -> None:
    device = tmp_path / "file"
    device.write_text("")
    assert offers_of(device) == []
