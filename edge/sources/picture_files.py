"""Reads picture files, and says so where one is damaged: OpenCV fills half a picture with grey."""

from pathlib import Path

import cv2
import numpy as np

from trigpoint.errors import InputError

PICTURE_SUFFIXES = frozenset(
    (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".pgm", ".ppm", ".pnm")
)
_JPEG_START, _JPEG_SCAN, _JPEG_END = b"\xff\xd8", b"\xff\xda", b"\xff\xd9"
_PNG_START, _PNG_END = b"\x89PNG", b"IEND"


def pictures_in(folder: Path) -> list[Path]:
    """The picture files of a folder by name; raise InputError where it is none or has none."""
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder; check the path")
    pictures = sorted(file for file in folder.iterdir() if is_picture(file))
    if not pictures:
        known = " ".join(sorted(PICTURE_SUFFIXES))
        raise InputError(f"{folder}: no pictures in this folder; put files in it ({known})")
    return pictures


def is_picture(file: Path) -> bool:
    """Whether a file's name is that of a picture."""
    return file.suffix.lower() in PICTURE_SUFFIXES and not file.name.startswith(".")


def read_picture(file: Path, *, in_colour: bool = False) -> np.ndarray:
    """A picture file as (height, width) grey or (height, width, 3) BGR, uint8.

    16 bits are scaled down and an alpha channel is left out. Raises InputError in one line where
    the file is missing, no picture, or cut short.
    """
    try:
        data = file.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{file}: there is no such picture; check the path") from None
    except OSError as reason:
        raise InputError(f"{file}: cannot be read ({reason.strerror}); check it") from None
    if is_cut_short(data):
        raise InputError(f"{file}: the picture is cut short; copy it again")
    mode = cv2.IMREAD_COLOR if in_colour else cv2.IMREAD_GRAYSCALE
    picture = _decoded(data, mode)
    if picture is None:
        raise InputError(f"{file}: this is no picture that can be read; check the file")
    return picture


def is_cut_short(data: bytes) -> bool:
    """Whether a JPEG or PNG lacks its end. (In a JPEG's scan neither marker can occur.)"""
    if data.startswith(_JPEG_START):
        return data.rfind(_JPEG_END) < max(data.rfind(_JPEG_SCAN), 0)
    return data.startswith(_PNG_START) and _PNG_END not in data


def _decoded(data: bytes, mode: int) -> np.ndarray | None:
    if not data:
        return None
    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), mode)
    except cv2.error:
        return None
