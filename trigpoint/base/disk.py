"""How much room a disk has left, and files that are written whole or not at all."""

import os
import shutil
from pathlib import Path


def free_bytes(directory: Path) -> float:
    """Room on the disk of a folder that may be yet to be made."""
    while not directory.exists():
        directory = directory.parent
    return shutil.disk_usage(directory).free


def replace_file(
    path: Path, *data: bytes | memoryview, mode: int = 0o666, is_synced: bool = False
) -> None:
    """Replace a file in one step: nobody finds a part of it, nor ever with wider permissions than
    `mode`, less the umask. `is_synced`: only once the disk has it. Raises OSError."""
    part = path.with_name(f"{path.name}.part")
    part.unlink(missing_ok=True)
    try:
        descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
        with os.fdopen(descriptor, "wb") as file:
            file.writelines(data)  # which takes what is large as it is
            if is_synced:
                file.flush()
                os.fsync(file.fileno())
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
