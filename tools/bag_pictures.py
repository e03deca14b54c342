"""Reads a bag's pictures, compressed or raw, as grey."""

from collections.abc import Collection, Iterator
from pathlib import Path

import cv2
import numpy as np

from trigpoint.errors import InputError
from trigpoint.messages import Picture
from trigpoint.recorder.bag import Bag, BagMessage, RawImage

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


def bag_pictures(path: Path, topics: Collection[str]) -> Iterator[tuple[str, str, np.ndarray]]:
    """(name, stem, grey picture) of a bag's pictures, named by topic and stamp.

    Without `topics` its only topic with pictures; raises InputError where there are several, or
    none, or a picture cannot be read.
    """
    bag = Bag(path)
    chosen = list(topics) or _only(path, bag)
    for one in bag.messages(chosen):
        if isinstance(one.message, (Picture, RawImage)):
            stamp_ns = one.message.stamp_ns or one.log_ns
            stem = f"{one.topic.strip('/').replace('/', '_')}_{stamp_ns}"
            yield f"{path}#{one.topic}#{stamp_ns}", stem, grey_of(path, one)


def grey_of(path: Path, one: BagMessage) -> np.ndarray:
    """A message's picture, (height, width) grey of any depth; raise InputError if it cannot be
    read."""
    message = one.message
    picture = None
    if isinstance(message, Picture):
        data = np.frombuffer(message.data, dtype=np.uint8)
        grey = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH
        picture = cv2.imdecode(data, grey) if data.size else None
    elif isinstance(message, RawImage):
        picture = _grey_of_raw(message)
    if picture is None:
        what = message.encoding if isinstance(message, RawImage) else "its bytes"
        raise InputError(f"{path}: a picture of {one.topic} cannot be read ({what}); convert it")
    return picture


def _grey_of_raw(image: RawImage) -> np.ndarray | None:
    if image.encoding in _GREY:
        return np.ascontiguousarray(image.data[:, : image.width])
    if image.encoding in _GREY_16:
        order = ">u2" if image.is_bigendian else "<u2"
        wide = np.ascontiguousarray(image.data[:, : 2 * image.width]).view(order)
        return wide.astype(np.uint16)
    if image.encoding not in _CONVERSIONS:
        return None
    channels, code = _CONVERSIONS[image.encoding]
    pixels = np.ascontiguousarray(image.data[:, : channels * image.width])
    if channels > 1:
        pixels = pixels.reshape(image.height, image.width, channels)
    return cv2.cvtColor(pixels, code)


def _only(path: Path, bag: Bag) -> list[str]:
    found = bag.pictures()
    if len(found) == 1:
        return found
    known = ", ".join(found or sorted(bag.topics))
    what = "several topics with pictures" if found else "no topic with pictures"
    raise InputError(f"{path}: there are {what} ({known}); name one with --topic")
