"""Files of a rosbag2 that were packed as a whole (`--compression-mode file`), unpacked."""

import atexit
import shutil
import tempfile
from functools import cache
from pathlib import Path

import zstandard

from trigpoint.errors import RecordingError

_PACKED = (".zstd", ".zst")


@cache
def unpacked(path: Path) -> Path:
    """The file itself, or what is in it where it is packed: that lies in the system's folder for
    temporary files until the program ends. Raises RecordingError where it cannot be unpacked."""
    if path.suffix not in _PACKED:
        return path
    folder = Path(tempfile.mkdtemp(prefix="trigpoint-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    file = folder / path.stem
    try:
        with path.open("rb") as source, file.open("wb") as to:
            zstandard.ZstdDecompressor().copy_stream(source, to)
    except OSError as reason:
        text = f"{path}: cannot be unpacked to {folder} ({reason.strerror}); make room there"
        raise RecordingError(text) from None
    except zstandard.ZstdError as reason:
        raise RecordingError(f"{path}: cannot be unpacked ({reason}); copy it again") from None
    return file
