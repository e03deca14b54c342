"""Reads a bag's pictures, compressed or raw, as grey."""

from collections.abc import Callable, Collection, Iterator
from pathlib import Path

import cv2
import numpy as np

from trigpoint.base.clock import to_seconds
from trigpoint.base.errors import InputError, MessageError
from trigpoint.base.words import counted
from trigpoint.contract.messages import Picture
from trigpoint.edge.sources.picture_files import decoded
from trigpoint.recorder.session.bag import Bag, RawImage

_CONVERSIONS = {
    "rgb8": (3, cv2.COLOR_RGB2GRAY),
    "bgr8": (3, cv2.COLOR_BGR2GRAY),
    "8UC3": (3, cv2.COLOR_BGR2GRAY),
    "rgba8": (4, cv2.COLOR_RGBA2GRAY),
    "bgra8": (4, cv2.COLOR_BGRA2GRAY),
    "8UC4": (4, cv2.COLOR_BGRA2GRAY),
    "yuv422": (2, cv2.COLOR_YUV2GRAY_UYVY),
    "uyvy": (2, cv2.COLOR_YUV2GRAY_UYVY),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2GRAY_YUYV),
    "yuyv": (2, cv2.COLOR_YUV2GRAY_YUYV),
    # The pattern names the first two pixels; OpenCV names the second row's second and third.
    "bayer_rggb8": (1, cv2.COLOR_BayerBG2GRAY),
    "bayer_bggr8": (1, cv2.COLOR_BayerRG2GRAY),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGR2GRAY),
    "bayer_grbg8": (1, cv2.COLOR_BayerGB2GRAY),
}
_GREY, _GREY_16 = ("mono8", "8UC1"), ("mono16", "16UC1")


def bag_pictures(
    path: Path, topics: Collection[str], leave_out: Callable[[InputError], None]
) -> Iterator[tuple[str, str, np.ndarray]]:
    """(name, stem, grey picture) of a bag's pictures, named by topic and stamp.

    Without `topics` its only topic with pictures; raises InputError where there are several, or
    none. `leave_out` is told of each picture that cannot be read.
    """
    bag = Bag(path)

    def refuse(topic: str, log_ns: int, reason: MessageError) -> None:
        at_s = f"{to_seconds(log_ns):.3f} s"
        leave_out(InputError(f"{path}: a picture of {topic}, at {at_s}: {reason}"))

    for one in bag.messages(list(topics) or _only(path, bag), refuse):
        if not isinstance(one.message, (Picture, RawImage)):
            continue
        stamp_ns = one.message.stamp_ns or one.log_ns
        stem = f"{one.topic.strip('/').replace('/', '_')}_{stamp_ns}"
        try:
            picture = grey_of(one.message)
        except MessageError as reason:
            refuse(one.topic, stamp_ns, reason)
            continue
        yield f"{path}#{one.topic}#{stamp_ns}", stem, picture


def grey_of(picture: Picture | RawImage) -> np.ndarray:
    """A message's picture, (height, width) grey of any depth; raise MessageError if it cannot be
    read."""
    if isinstance(picture, RawImage):
        return _grey_of_raw(picture)
    try:
        return decoded(picture.data)
    except InputError as reason:
        size = counted(len(picture.data), "byte")
        raise MessageError(f"{reason} ({size}, {picture.format or 'no format'})") from None


def _grey_of_raw(image: RawImage) -> np.ndarray:
    if image.encoding in _GREY:
        return _rows(image, 1)
    if image.encoding in _GREY_16:
        wide = _rows(image, 2).view(">u2" if image.is_bigendian else "<u2")
        return wide.astype(np.uint16)
    if image.encoding not in _CONVERSIONS:
        raise MessageError(f"its encoding is «{image.encoding}»; convert it")
    channels, code = _CONVERSIONS[image.encoding]
    pixels = _rows(image, channels)
    if channels > 1:
        pixels = pixels.reshape(image.height, image.width, channels)
    return cv2.cvtColor(pixels, code)


def _rows(image: RawImage, pixel: int) -> np.ndarray:
    """The bytes of a picture, (height, width · `pixel`), without what fills its rows; drivers that
    do not set `step` mean rows that are not filled."""
    width, height, size = image.width * pixel, image.height, image.data.size
    for step in (image.step, width):
        if min(width, height) > 0 and step >= width and size >= step * (height - 1) + width:
            rows = image.data[: step * height]
            rows = np.pad(rows, (0, step * height - rows.size)).reshape(height, step)
            return np.ascontiguousarray(rows[:, :width])
    raise MessageError(
        f"its {counted(size, 'byte')} are no {image.width} × {height} pixels of {image.encoding}"
    )


def _only(path: Path, bag: Bag) -> list[str]:
    found = bag.pictures()
    if len(found) == 1:
        return found
    known = ", ".join(found or sorted(bag.topics))
    what = "several topics with pictures" if found else "no topic with pictures"
    raise InputError(f"{path}: there are {what} ({known}); name one with --topic")
