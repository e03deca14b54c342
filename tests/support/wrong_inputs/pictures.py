"""Folders in which pictures are not all as they should be."""

from collections.abc import Callable, Mapping
from pathlib import Path

import cv2
import numpy as np

from .case import LEFT_OUT, Case, Kind
from .targets import board, shots, write_shots, write_target

_HEIC = b"\0\0\0\x18ftypheic\0\0\0\0mif1heic"
_SIDEWAYS = (5, 6, 7, 8)


def jpeg(picture: np.ndarray) -> bytes:
    return cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()


def png(picture: np.ndarray) -> bytes:
    return cv2.imencode(".png", picture)[1].tobytes()


_BAD: Mapping[str, Callable[[np.ndarray, np.random.Generator], bytes]] = {
    "empty.png": lambda _picture, _random: b"",
    "noise.jpg": lambda _picture, random: random.bytes(3000),
    "half.png": lambda picture, random: png(picture)[: int(random.integers(100, 20_000))],
    "half.jpg": lambda picture, random: jpeg(picture)[: int(random.integers(1000, 20_000))],
    "notes.jpg": lambda _picture, _random: b"the camera was moved after lunch\n",
    "phone.heic": lambda _picture, random: _HEIC + random.bytes(3000),
    "phone.jpg": lambda _picture, random: _HEIC + random.bytes(3000),
}
"""Files that are no pictures, by name."""


def bad_among_good(folder: Path, random: np.random.Generator) -> Case:
    face, count = board(random), int(random.integers(3, 7))
    good = shots(face, random, count)
    pictures = write_shots(folder, good)
    names = [str(name) for name in random.permutation(list(_BAD))[: random.integers(1, 3)]]
    for name in names:
        (pictures / name).write_bytes(_BAD[name](good[0], random))
    words = ("detect", pictures, "--json", "--target", write_target(folder, face))
    return Case(words, says=(LEFT_OUT, *names), seen=count)


def none_good(folder: Path, random: np.random.Generator) -> Case:
    face = board(random)
    pictures = write_shots(folder, [])
    name = str(random.choice(list(_BAD)))
    (pictures / name).write_bytes(_BAD[name](shots(face, random, 1)[0], random))
    words = ("detect", pictures, "--json", "--target", write_target(folder, face))
    return Case(words, (1, 2), (name,))


def deep(folder: Path, random: np.random.Generator) -> Case:
    """10 or 12 bits in 16."""
    face, count = board(random), int(random.integers(2, 5))
    bits = int(random.choice([10, 12]))
    wide = [picture.astype(np.uint16) << (bits - 8) for picture in shots(face, random, count)]
    words = ("detect", write_shots(folder, wide), "--json", "--target", write_target(folder, face))
    return Case(words, seen=count)


def exif_mixed(folder: Path, random: np.random.Generator) -> Case:
    """A phone's pictures, some of them stored upright and to be shown sideways."""
    face = board(random)
    pictures = write_shots(folder, [])
    for number, picture in enumerate(shots(face, random, 8)):
        turned = int(random.choice(_SIDEWAYS)) if number % 2 else 1
        (pictures / f"{number}.jpg").write_bytes(_oriented(jpeg(picture), turned))
    words = ("intrinsics", pictures, "--target", write_target(folder, face))
    return Case((*words, "--out", folder / "lens.yaml"), (0, 1, 2), ("EXIF",))


def _oriented(data: bytes, orientation: int) -> bytes:
    """A JPEG with EXIF's entry on how to turn it."""
    entry = b"\x01\x12\0\x03\0\0\0\x01" + bytes([0, orientation, 0, 0])
    exif = b"Exif\0\0MM\0*\0\0\0\x08\0\x01" + entry + bytes(4)
    return data[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + data[2:]


PICTURES: Mapping[str, Kind] = {
    "bad pictures among good": bad_among_good,
    "no picture that can be read": none_good,
    "10 or 12 bits in 16": deep,
    "EXIF mixed": exif_mixed,
}
