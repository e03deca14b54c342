"""Opens an MCAP file, sound or not.

A finished file is opened by the summary at its end, even if an earlier record is damaged. A file
without one (its recorder was killed, or it was truncated) is walked record by record; after a
damaged record, the walk continues at the next chunk. Only the damaged parts are lost, and they are
named.
"""

from pathlib import Path
from typing import IO

from trigpoint.base.errors import RecordingError

from .damaged import walk
from .file import McapIndex
from .packed import unpacked
from .records import MAGIC
from .summary import read_summary

# What people give in its place, by its first bytes, and what to do.
_OTHERS = {
    b"#ROSBAG V": "a ROS 1 bag; name it .bag, and where it was not closed: rosbag reindex",
    b"SQLite format 3": "a rosbag2's database; name it .db3, or give its folder",
    b"\x1f\x8b": "packed by gzip; unpack it: gunzip",
    b"\x28\xb5\x2f\xfd": "packed by zstd; name it .zstd, or unpack it: zstd -d",
    b"BZh": "packed by bzip2; unpack it: bunzip2",
    b"PK\x03\x04": "a zip archive; unpack it: unzip",
    b"\x89PNG": "a picture",
    b"\xff\xd8\xff": "a picture",
}
LONGEST_MAGIC = max(map(len, _OTHERS))


def read_index(path: Path) -> McapIndex:
    """The index of a file; raise RecordingError if it is not an MCAP file at all."""
    try:
        with unpacked(path).open("rb") as file:
            _check_magic(path, file)
            return read_summary(path, file) or walk(path, file)
    except OSError as reason:
        raise RecordingError(f"{path}: cannot be read ({reason.strerror}); check it") from None


def _check_magic(path: Path, file: IO[bytes]) -> None:
    refuse_others(path, file.read(LONGEST_MAGIC))
    file.seek(len(MAGIC))


def refuse_others(path: Path, begin: bytes) -> None:
    """Raise RecordingError where a file that begins so is no MCAP file, by what it is."""
    if not begin:
        raise RecordingError(f"{path}: the file is empty; nothing was recorded into it")
    if begin.startswith(MAGIC):
        return
    for magic, words in _OTHERS.items():
        if begin.startswith(magic):
            raise RecordingError(f"{path}: this is no MCAP file, but {words}")
    raise RecordingError(f"{path}: this is no MCAP file; give a session that was recorded")
