"""Files that are replaced whole, with a head and a checksum."""

import zlib
from pathlib import Path

from trigpoint.base.disk import replace_file

_CHECK = 4  # bytes of the checksum


def save_checked(
    path: Path, magic: bytes, *body: bytes | memoryview, is_synced: bool = True
) -> None:
    """Replace a file by a body in parts; a killed process leaves the one before. `is_synced`: only
    once the disk has it. Raises OSError where the disk does not take it."""
    check = 0
    for some in body:
        check = zlib.crc32(some, check)
    replace_file(path, magic + check.to_bytes(_CHECK, "little"), *body, is_synced=is_synced)


def checked_body(data: bytes, magic: bytes) -> bytes | None:
    """The body of a file's bytes; None where they are not whole, or of another kind."""
    body = data[len(magic) + _CHECK :]
    check = int.from_bytes(data[len(magic) :][:_CHECK], "little")
    return body if data.startswith(magic) and zlib.crc32(body) == check else None
