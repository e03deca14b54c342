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


def read_index(path: Path) -> McapIndex:
    """The index of a file; raise RecordingError if it is not an MCAP file at all."""
    try:
        with unpacked(path).open("rb") as file:
            _check_magic(path, file)
            return read_summary(path, file) or walk(path, file)
    except OSError as reason:
        raise RecordingError(f"{path}: cannot be read ({reason.strerror}); check it") from None


def _check_magic(path: Path, file: IO[bytes]) -> None:
    start = file.read(len(MAGIC))
    if not start:
        raise RecordingError(f"{path}: the file is empty; nothing was recorded into it")
    if start != MAGIC:
        raise RecordingError(f"{path}: this is no MCAP file; give a session that was recorded")
