"""How much room a disk has left."""

import shutil
from pathlib import Path


def free_bytes(directory: Path) -> float:
    """Room on the disk of a folder that may be yet to be made."""
    while not directory.exists():
        directory = directory.parent
    return shutil.disk_usage(directory).free
