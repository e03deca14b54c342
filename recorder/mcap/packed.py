"""Bags of rosbag2 that are no plain MCAP file, as one: packed file by file or message by message
(`--compression-mode`), or in SQLite."""

import atexit
import logging
import shutil
import tempfile
from functools import cache
from pathlib import Path
from typing import IO

import zstandard

from trigpoint.base.errors import RecordingError
from trigpoint.base.terminal import waiting

_PACKED = (".zstd", ".zst")
_PIECE = 1 << 11  # bytes unpacked at once: 4 may be a block of 128 KiB, so these 64 MiB

_LOG = logging.getLogger(__name__)


@cache
def unpacked(path: Path) -> Path:
    """The file itself, or what is in it as MCAP: that lies in the system's folder for temporary
    files until the program ends. Raises RecordingError where it cannot be unpacked.

    `path`: one of `session_files`.
    """
    if path.suffix == ".bag":
        raise RecordingError(
            f"{path}: this is a ROS 1 bag, which only detect, intrinsics and calibrate read; for "
            f"the rest convert it: rosbags-convert --src {path} --dst {path.stem}"
        )
    is_packed, is_foreign = path.suffix in _PACKED, path.suffix == ".db3" or path.is_dir()
    if not is_packed and not is_foreign:
        return path
    folder = Path(tempfile.mkdtemp(prefix="trigpoint-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    if is_foreign:
        from .rosbag_files import RosbagFiles  # rosbags takes long to import

        file = folder / f"{path.name.removesuffix('.db3')}.mcap"
        with waiting(f"{path}: made MCAP"):
            RosbagFiles(path).save(file)
        return file
    file = folder / path.stem
    try:
        with path.open("rb") as source, file.open("wb") as to, waiting(f"{path}: unpacked"):
            is_whole = _unpack(source, to)
    except OSError as reason:
        text = f"{path}: cannot be unpacked to {folder} ({reason.strerror}); make room there"
        raise RecordingError(text) from None
    except zstandard.ZstdError as reason:
        raise RecordingError(f"{path}: cannot be unpacked ({reason}); copy it again") from None
    if not is_whole:
        if file.stat().st_size == 0:
            raise RecordingError(f"{path}: the packed file breaks off at once; copy it again")
        _LOG.warning("%s: the packed file breaks off, its end is missing; copy it again", path)
    return unpacked(file)


def _unpack(source: IO[bytes], to: IO[bytes]) -> bool:
    """Unpack all frames of a zstd file; whether it has its end. Raises ZstdError."""
    rest = b""
    frame = zstandard.ZstdDecompressor().decompressobj()
    while piece := rest or source.read(_PIECE):
        if frame.eof:
            frame = zstandard.ZstdDecompressor().decompressobj()
        to.write(frame.decompress(piece))
        rest = frame.unused_data if frame.eof else b""
    return frame.eof
