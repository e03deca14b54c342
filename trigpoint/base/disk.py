"""How much room a disk has left, and files that are written whole or not at all."""

import os
import shutil
from pathlib import Path


def free_bytes(directory: Path) -> float:
    """Room on the disk of a folder that may be yet to be made."""
    while not directory.exists():
        directory = directory.parent
    return shutil.disk_usage(directory).free


def replace_file(path: Path, data: bytes, *, mode: int = 0o666) -> None:
    """Replace a file in one step: nobody finds a part of it, nor ever with wider permissions than
    `mode`, less the umask. Raises OSError."""
    part = path.with_name(f"{path.name}.part")
    part.unlink(missing_ok=True)
    try:
        descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
