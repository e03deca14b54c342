"""Reads picture files, whatever their names end in, and says why one cannot be read.

Files are turned as their EXIF orientation says, like every viewer does. A lens belongs to the
sensor, so pictures that are turned differently cannot be one camera's set.
"""

import mmap
import struct
from collections.abc import Iterable
from itertools import islice
from pathlib import Path

import cv2
import numpy as np

from trigpoint.base.errors import InputError
from trigpoint.contract.picture_bytes import is_cut_short

PICTURE_SUFFIXES = frozenset(
    (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".pgm", ".ppm", ".pnm")
)
_FOREIGN = {
    "a HEIC picture, which OpenCV does not read; convert it to JPEG (heif-convert), and set the "
    "phone to «most compatible»": (".heic", ".heif", ".hif"),
    "a camera's raw file; develop it to 16 bit TIFF or PNG": (
        *(".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2"),
    ),
}
_FOREIGN_SUFFIXES = {suffix: what for what, suffixes in _FOREIGN.items() for suffix in suffixes}
_HEIC = next(iter(_FOREIGN))
_HEIC_BRANDS = (b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1")
_GREY = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH
# Where EXIF's block begins: after its marker in a JPEG, a PNG's chunk, a WebP's chunk and its size.
_EXIF_MARKS = ((b"Exif\0\0", 6), (b"eXIf", 4), (b"EXIF", 8))
_ENDS_BYTES = 1 << 16
"""So far from a file's ends is it looked for, except in a TIFF, which says where it is."""
_ORIENTATION = 0x112
_UPRIGHT = 1
# More names than these nobody reads.
_MOST_NAMED = 5


def pictures_in(folder: Path) -> list[Path]:
    """The picture files of a folder by name; raise InputError where it is none or has none."""
    pictures = listed_pictures(folder)
    if not pictures:
        folders = (f.name for f in sorted(folder.iterdir()) if f.is_dir() and listed_pictures(f))
        if inside := list(islice(folders, _MOST_NAMED + 1)):
            names = ", ".join([*inside[:_MOST_NAMED], *(["…"] * (len(inside) > _MOST_NAMED))])
            raise InputError(
                f"{folder}: no pictures in this folder, but in those in it ({names}); name one"
            )
        known = " ".join(sorted(PICTURE_SUFFIXES))
        raise InputError(f"{folder}: no pictures in this folder; put files in it ({known})")
    return pictures


def listed_pictures(folder: Path) -> list[Path]:
    """Like `pictures_in`, of a folder that may be empty yet."""
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder; check the path")
    return sorted(file for file in folder.iterdir() if is_picture(file))


def is_picture(file: Path) -> bool:
    """Whether a file is a picture by its name, readable or not, or by its content."""
    if file.name.startswith("."):
        return False
    suffix = file.suffix.lower()
    is_named = suffix in PICTURE_SUFFIXES or suffix in _FOREIGN_SUFFIXES
    return is_named or (file.is_file() and cv2.haveImageReader(str(file)))


def read_picture(file: Path) -> np.ndarray:
    """A picture file as it is shown: (height, width) grey, of its own depth; some kinds in colour.

    Raises InputError in one line where the file is missing, no picture, or cut short.
    """
    try:
        data = file.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{file}: there is no such picture; check the path") from None
    except OSError as reason:
        raise InputError(f"{file}: cannot be read ({reason.strerror}); check it") from None
    if file.suffix.lower() in _FOREIGN_SUFFIXES:
        raise InputError(f"{file}: this is {_FOREIGN_SUFFIXES[file.suffix.lower()]}")
    try:
        return decoded(data)
    except InputError as reason:
        raise InputError(f"{file}: {reason}") from None


def decoded(data: bytes) -> np.ndarray:
    """The same of a file's bytes, or of a message's."""
    if not data:
        raise InputError("this is no picture but empty")
    if is_cut_short(data):
        raise InputError("the picture is cut short")
    picture = _decoded(data, _GREY)
    if picture is None:
        picture = _decoded(data, cv2.IMREAD_UNCHANGED)  # real numbers in colour
    if picture is None and data[4:8] == b"ftyp" and data[8:12] in _HEIC_BRANDS:
        raise InputError(f"this is {_HEIC}")
    if picture is None:
        raise InputError("this is no picture that can be read")
    return picture


def _decoded(data: bytes, mode: int) -> np.ndarray | None:
    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), mode)
    except cv2.error:
        return None


def check_orientations(files: Iterable[Path]) -> None:
    """Raise InputError where EXIF turns some of these pictures otherwise than others."""
    turned: dict[int, list[Path]] = {}
    for file in files:
        if cv2.haveImageReader(str(file)):
            turned.setdefault(orientation(file), []).append(file)
    if len(turned) > 1:
        each = sorted(turned.items(), key=lambda item: -len(item[1]))
        counts = ", ".join(f"{len(names)} of {number}" for number, names in each)
        raise InputError(
            f"{each[1][1][0]}: EXIF turns it otherwise than the rest (orientations: {counts}), so "
            "rows and columns are not the sensor's; give pictures that were held one way, or where "
            "the files are as the sensor gave them, take the mark off: exiftool -Orientation= FILES"
        )


def orientation(file: Path) -> int:
    """A picture's orientation by EXIF, 1 … 8; 1, upright, where it says none."""
    with (
        file.open("rb") as opened,
        mmap.mmap(opened.fileno(), 0, access=mmap.ACCESS_READ) as data,
    ):
        begins = [0]
        for mark, skip in _EXIF_MARKS:
            begins.append(data.find(mark, 0, _ENDS_BYTES) + skip)
            begins.append(data.rfind(mark, max(0, len(data) - _ENDS_BYTES)) + skip)
        return next((found for at in begins if (found := _tagged(data, at))), _UPRIGHT)


def _tagged(data: mmap.mmap, at: int) -> int | None:
    """The orientation in the first directory of a TIFF header there; None where it has none."""
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(data[at : at + 4])
    if order is None:
        return None
    try:
        first = at + struct.unpack_from(f"{order}I", data, at + 4)[0]
        (count,) = struct.unpack_from(f"{order}H", data, first)
        for entry in range(first + 2, first + 2 + 12 * count, 12):
            tag, _, _, value = struct.unpack_from(f"{order}HHIH", data, entry)
            if tag == _ORIENTATION and value in range(1, 9):
                return value
    except struct.error:
        pass  # the file is damaged
    return None
