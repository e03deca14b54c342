"""Reads a bag's pictures, compressed or raw, as grey."""

from collections.abc import Collection, Iterator
from pathlib import Path

import cv2
import numpy as np

from trigpoint.base.clock import to_seconds
from trigpoint.base.errors import InputError, MessageError
from trigpoint.base.words import counted, numberless
from trigpoint.contract.messages import Picture
from trigpoint.edge.sources.picture_files import decoded
from trigpoint.recorder.session.bag import Bag, RawImage

from .account import PictureAccount

# Bytes a sample, samples a pixel, and how they become grey, by the encoding in small letters.
_CONVERSIONS: dict[str, tuple[int, int, int | None]] = {
    "mono8": (1, 1, None),
    "8uc1": (1, 1, None),
    "mono16": (2, 1, None),
    "16uc1": (2, 1, None),
    "rgb8": (1, 3, cv2.COLOR_RGB2GRAY),
    "bgr8": (1, 3, cv2.COLOR_BGR2GRAY),
    "8uc3": (1, 3, cv2.COLOR_BGR2GRAY),
    "rgba8": (1, 4, cv2.COLOR_RGBA2GRAY),
    "bgra8": (1, 4, cv2.COLOR_BGRA2GRAY),
    "8uc4": (1, 4, cv2.COLOR_BGRA2GRAY),
    "rgb16": (2, 3, cv2.COLOR_RGB2GRAY),
    "bgr16": (2, 3, cv2.COLOR_BGR2GRAY),
    "rgba16": (2, 4, cv2.COLOR_RGBA2GRAY),
    "bgra16": (2, 4, cv2.COLOR_BGRA2GRAY),
    "yuv422": (1, 2, cv2.COLOR_YUV2GRAY_UYVY),
    "uyvy": (1, 2, cv2.COLOR_YUV2GRAY_UYVY),
    "yuv422_yuy2": (1, 2, cv2.COLOR_YUV2GRAY_YUYV),
    "yuyv": (1, 2, cv2.COLOR_YUV2GRAY_YUYV),
    # Grey comes first, whole; colours lie behind it.
    "nv12": (1, 1, None),
    "nv21": (1, 1, None),
    "nv24": (1, 1, None),
    "i420": (1, 1, None),
    # The pattern names the first two pixels; OpenCV names the second row's second and third.
    "bayer_rggb8": (1, 1, cv2.COLOR_BayerBG2GRAY),
    "bayer_bggr8": (1, 1, cv2.COLOR_BayerRG2GRAY),
    "bayer_gbrg8": (1, 1, cv2.COLOR_BayerGR2GRAY),
    "bayer_grbg8": (1, 1, cv2.COLOR_BayerGB2GRAY),
    "bayer_rggb16": (2, 1, cv2.COLOR_BayerBG2GRAY),
    "bayer_bggr16": (2, 1, cv2.COLOR_BayerRG2GRAY),
    "bayer_gbrg16": (2, 1, cv2.COLOR_BayerGR2GRAY),
    "bayer_grbg16": (2, 1, cv2.COLOR_BayerGB2GRAY),
}
# Other planes follow these. Rows are filled up to so many bytes at most.
_PLANES, _WIDEST_FILL = ("nv12", "nv21", "nv24", "i420"), 512
# Of brightness and colour by turns, neighbours differ by so many times what their next ones do.
_BY_TURNS = 2.0
# Formats of compressed messages that hold no pictures, and what to do.
_NO_PICTURES = {
    "compresseddepth": "that is depth, not a picture; name the topic of the camera's pictures",
    "h264": "that is a part of a video; make pictures of it: ros2 run image_transport republish",
    "h265": "that is a part of a video; make pictures of it: ros2 run image_transport republish",
    "hevc": "that is a part of a video; make pictures of it: ros2 run image_transport republish",
}


def bag_pictures(
    path: Path, topics: Collection[str], account: PictureAccount
) -> Iterator[tuple[str, str, np.ndarray]]:
    """(name, stem, grey picture) of a bag's pictures, named by topic and stamp.

    Without `topics` its only topic with pictures; raises InputError where there are several, or
    none. `account` is told of each picture that cannot be read.
    """
    bag = Bag(path)

    def refuse(topic: str, log_ns: int, reason: MessageError) -> None:
        at_s = f"{to_seconds(log_ns):.3f} s"
        said = InputError(f"{path}: a picture of {topic}, at {at_s}: {reason}")
        account.leave_out(said, f"{path} {topic} {numberless(str(reason))}")

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
        said = f"{counted(len(picture.data), 'byte')}, {picture.format or 'no format'}"
        ways = [way for name, way in _NO_PICTURES.items() if name in picture.format.lower()]
        raise MessageError(f"{reason} ({said}){''.join(f': {way}' for way in ways)}") from None


def _grey_of_raw(image: RawImage) -> np.ndarray:
    known = _CONVERSIONS.get(image.encoding.lower())
    if known is None:
        raise MessageError(
            f"its encoding is «{image.encoding}»; have it published as mono8 or bgr8, or as JPEG"
        )
    size, samples, code = known
    pixels = _rows(image, size * samples)
    if size > 1:
        pixels = pixels.view(">u2" if image.is_bigendian else "<u2").astype(np.uint16)
    if samples > 1:
        pixels = pixels.reshape(image.height, image.width, samples)
    return pixels if code is None else cv2.cvtColor(pixels, code)


def _rows(image: RawImage, pixel: int) -> np.ndarray:
    """The bytes of a picture, (height, width · `pixel`), without what fills its rows; drivers that
    do not set `step` mean rows that are not filled."""
    width, height, size = image.width * pixel, image.height, image.data.size
    _check_rows(image, width)
    for step in (image.step, width):
        if min(width, height) > 0 and step >= width and size >= step * (height - 1) + width:
            rows = image.data[: step * height]
            rows = np.pad(rows, (0, step * height - rows.size)).reshape(height, step)
            return np.ascontiguousarray(rows[:, :width])
    raise MessageError(
        f"its {counted(size, 'byte')} are no {image.width} × {height} pixels of {image.encoding}"
    )


def _check_rows(image: RawImage, width: int) -> None:
    """Raise MessageError where pixels of a byte, in rows of `width` bytes, come with as many bytes
    as those of two to four values a pixel have: the encoding is another one."""
    if image.encoding.lower() in _PLANES or width > image.width:
        return
    times = image.data.size // max(width * image.height, 1)
    is_other = times in (3, 4) or (times == 2 and _is_by_turns(image.data))
    if width > _WIDEST_FILL and is_other and image.step in (0, width, times * width):
        samples = f"{image.width} × {image.height} pixels of {image.encoding}"
        raise MessageError(
            f"its {counted(image.data.size, 'byte')} are {times} times {samples}; name the "
            "encoding that it has"
        )


def _is_by_turns(data: np.ndarray) -> bool:
    """Whether bytes (n,) are of two kinds by turns, as in YUYV: those two apart are more alike than
    neighbours are. Not so, where rows are those of two pictures side by side."""
    values = data.astype(np.int16)
    beside, next_but_one = (np.abs(values[n:] - values[:-n]).mean() for n in (1, 2))
    return bool(beside > _BY_TURNS * next_but_one)


def _only(path: Path, bag: Bag) -> list[str]:
    found = bag.pictures()
    if len(found) == 1:
        return found
    if found:
        names = ", ".join(found)
        text = f"there are several topics with pictures ({names}); name one with --topic"
    else:
        text = f"no topic in it has pictures (it has {bag.known}); give a bag with a camera's"
        if bag.is_foreign:
            text += ", or where these are pictures, convert it to ROS 2's CDR"
    raise InputError(f"{path}: {text}")
