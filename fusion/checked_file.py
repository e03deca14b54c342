"""Files that are replaced whole, with a head and a checksum."""

import os
import zlib
from io import FileIO
from pathlib import Path

_CHECK = 4  # bytes of the checksum


def save_checked(
    path: Path, magic: bytes, *body: bytes | memoryview, is_synced: bool = True
) -> None:
    """Replace a file by a body in parts; a killed process leaves the one before. `is_synced`: only
    once the disk has it. Raises OSError where the disk does not take it."""
    part, check = path.with_suffix(".part"), 0
    for some in body:
        check = zlib.crc32(some, check)
    with part.open("wb", buffering=0) as file:
        for some in (magic + check.to_bytes(_CHECK, "little"), *body):
            _write(file, memoryview(some))
        if is_synced:
            file.flush()
            os.fsync(file.fileno())
    part.replace(path)


def _write(file: FileIO, some: memoryview) -> None:
    while some:
        some = some[file.write(some) :]


def checked_body(data: bytes, magic: bytes) -> bytes | None:
    """The body of a file's bytes; None where they are not whole, or of another kind."""
    body = data[len(magic) + _CHECK :]
    check = int.from_bytes(data[len(magic) :][:_CHECK], "little")
    return body if data.startswith(magic) and zlib.crc32(body) == check else None
