"""Opens an MCAP file, sound or not.

A finished file is opened by the summary at its end, also where a record before it is damaged. A
file without one (its recorder was killed, it was cut) is walked record by record; where one is
damaged, the walk goes on at the next chunk. What is damaged costs itself and is named.
"""

from pathlib import Path
from typing import IO

from trigpoint.errors import RecordingError

from .mcap_damaged import walk
from .mcap_file import McapIndex
from .mcap_records import MAGIC
from .mcap_summary import read_summary


def read_index(path: Path) -> McapIndex:
    """What a file holds; raise RecordingError where it is no MCAP file at all."""
    try:
        with path.open("rb") as file:
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
