"""Room on the disk: how much is left, and which finished sessions may make more."""

import os
import shutil
from dataclasses import dataclass
from pathlib import Path

from trigpoint.recorder.mcap.records import MAGIC


@dataclass(frozen=True, slots=True)
class Room:
    """`minimum_free`: bytes that stay free in `directory`, 0 where it does not matter; `prefix`:
    how the folders of this site's sessions begin. `frees_oldest`: finished ones may be removed."""

    directory: Path
    minimum_free: float
    frees_oldest: bool
    prefix: str

    def problem(self, running: Path) -> str:
        """Why there is no room to go on, "" where there is.

        The oldest finished sessions are removed first, as far as that is allowed, never the one in
        the folder `running` nor one whose end was not written.
        """
        while (free := free_bytes(self.directory)) < self.minimum_free:
            oldest = self._oldest(running) if self.frees_oldest else None
            if oldest is None:
                return (
                    f"{self.directory}: {free / 1e9:.2f} GB are free, {self.minimum_free / 1e9:.2f}"
                    " GB must stay (minimum_free under [recorder]); make room on the disk"
                )
            _remove(oldest)
        return ""

    def _oldest(self, running: Path) -> Path | None:
        if not self.directory.is_dir():
            return None
        folders = sorted(self.directory.glob(f"{self.prefix}_*T*Z"))  # their names are times
        here = running.resolve()
        return next((f for f in folders if f.resolve() != here and _is_finished(f)), None)


def free_bytes(directory: Path) -> float:
    """Room on the disk of a folder that may be yet to be made."""
    while not directory.exists():
        directory = directory.parent
    return shutil.disk_usage(directory).free


def _is_finished(folder: Path) -> bool:
    files = list(folder.glob("*.mcap"))
    return bool(files) and all(_ends_well(file) for file in files)


def _ends_well(file: Path) -> bool:
    with file.open("rb") as opened:
        opened.seek(-min(len(MAGIC), file.stat().st_size), os.SEEK_END)
        return file.stat().st_size > len(MAGIC) and opened.read() == MAGIC


def _remove(folder: Path) -> None:
    """A session's recording; what people put beside it stays."""
    for file in [*folder.glob("*.mcap"), folder / "metadata.yaml"]:
        file.unlink(missing_ok=True)
    if not any(folder.iterdir()):
        folder.rmdir()
