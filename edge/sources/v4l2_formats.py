"""What a Video4Linux camera offers: its picture formats, sizes and rates, asked of the kernel.

OpenCV does not tell. The numbers and structures are those of linux/videodev2.h.
"""

import fcntl
import os
import struct
from collections.abc import Callable, Iterator
from pathlib import Path

from msgspec import Struct

_CAPTURE = 1  # V4L2_BUF_TYPE_VIDEO_CAPTURE
_DISCRETE = 1
_MOST = 64
_FORMAT_BYTES, _SIZE_BYTES, _INTERVAL_BYTES = 64, 44, 52

Ioctl = Callable[[int, int, bytearray], int]


class Offer(Struct, frozen=True):
    """One format at one size, and the most pictures a second; 0 where that is not told."""

    format: str
    width: int
    height: int
    rate: float


def offers_of(device: Path, *, ioctl: Ioctl = fcntl.ioctl) -> list[Offer]:
    """Everything that a camera offers; raises OSError where it cannot be asked.

    A camera that scales freely is given by its largest size.
    """
    file = os.open(device, os.O_RDWR | os.O_NONBLOCK)
    try:
        return [
            Offer(
                _letters(pixel_format),
                width,
                height,
                _rate(ioctl, file, pixel_format, width, height),
            )
            for pixel_format in _formats(ioctl, file)
            for width, height in _sizes(ioctl, file, pixel_format)
        ]
    finally:
        os.close(file)


def _formats(ioctl: Ioctl, file: int) -> Iterator[int]:
    for index in range(_MOST):
        request = bytearray(struct.pack("2I", index, _CAPTURE).ljust(_FORMAT_BYTES, b"\0"))
        if not _ask(ioctl, file, 2, request):
            return
        yield struct.unpack_from("I", request, 44)[0]


def _sizes(ioctl: Ioctl, file: int, pixel_format: int) -> Iterator[tuple[int, int]]:
    for index in range(_MOST):
        request = bytearray(struct.pack("2I", index, pixel_format).ljust(_SIZE_BYTES, b"\0"))
        if not _ask(ioctl, file, 74, request):
            return
        kind, *sides = struct.unpack_from("7I", request, 8)
        if kind == _DISCRETE:
            yield sides[0], sides[1]
        else:  # least, most and step of the width, then of the height
            yield sides[1], sides[4]
            return


def _rate(ioctl: Ioctl, file: int, pixel_format: int, width: int, height: int) -> float:
    """The highest: a camera lists its shortest interval first."""
    head = struct.pack("4I", 0, pixel_format, width, height)
    request = bytearray(head.ljust(_INTERVAL_BYTES, b"\0"))
    if not _ask(ioctl, file, 75, request):
        return 0.0
    _, numerator, denominator = struct.unpack_from("3I", request, 16)
    return denominator / numerator if numerator else 0.0


def _ask(ioctl: Ioctl, file: int, number: int, request: bytearray) -> bool:
    """Fill in `request`; false at the end of a list."""
    code = 3 << 30 | len(request) << 16 | ord("V") << 8 | number  # _IOWR('V', number, …)
    try:
        ioctl(file, code, request)
    except OSError:
        return False
    return True


def _letters(pixel_format: int) -> str:
    return pixel_format.to_bytes(4, "little").decode("ascii", errors="replace").strip()
