"""Room on the disk: how much is left, and which finished recordings may make more."""

import os
from collections.abc import Iterable, Iterator
from glob import escape
from pathlib import Path

from msgspec import Struct

from trigpoint.base.disk import free_bytes
from trigpoint.recorder.mcap.records import MAGIC


class Room(Struct, frozen=True):
    """`minimum_free`: bytes that stay free on the disk of the running session, 0 where it does not
    matter; `directory`: where this site's sessions are, whose folders begin with `prefix`.
    `frees_oldest`: finished ones may be removed for that; `budget`: bytes that all of them may take
    together, for which the oldest are removed in any case; 0: any number."""

    directory: Path
    minimum_free: float
    frees_oldest: bool
    prefix: str
    budget: float = 0.0

    def problem(self, running: Path, finished: Iterable[Path] = ()) -> str:
        """Why there is no room to go on, "" where there is.

        The oldest finished sessions are removed first, as far as that is allowed, never one whose
        end was not written; for the budget then the `finished` parts, given in their order, of the
        one in the folder `running`, but for the last.
        """
        try:
            return self._over_budget(running, list(finished)[:-1]) or self._too_full(running)
        except OSError as reason:
            return f"{reason.filename}: cannot be removed ({reason.strerror}); remove it"

    def _too_full(self, running: Path) -> str:
        while (free := free_bytes(running)) < self.minimum_free:
            disk = running.stat().st_dev
            on_disk = (f for f in self._finished(running) if f.stat().st_dev == disk)
            oldest = next(on_disk, None) if self.frees_oldest else None
            if oldest is None:
                return (
                    f"{running}: {free / 1e9:.2f} GB are free, {self.minimum_free / 1e9:.2f}"
                    " GB must stay (minimum_free under [recorder]); make room on the disk"
                )
            _remove(oldest)
        return ""

    def _over_budget(self, running: Path, parts: list[Path]) -> str:
        while self.budget and (taken := self._taken(running)) > self.budget:
            oldest = next(self._finished(running), None)
            if oldest is not None:
                _remove(oldest)
            elif parts:
                parts.pop(0).unlink(missing_ok=True)
            else:
                return (
                    f"{self.directory}: recordings take {taken / 1e9:.2f} GB, "
                    f"{self.budget / 1e9:.2f} are allowed (budget under [recorder]), and none of "
                    "them may be removed; allow more, or remove some"
                )
        return ""

    def _taken(self, running: Path) -> int:
        files = {file.resolve() for folder in self._folders() for file in folder.glob("*.mcap")}
        files |= {file.resolve() for file in running.glob("*.mcap")}
        return sum(file.stat().st_size for file in files)

    def _folders(self) -> list[Path]:
        """The folders of this site's sessions, the oldest first: their names are times."""
        digits = "[0-9]"
        time = f"{digits * 8}T{digits * 6}Z"
        return sorted(self.directory.glob(f"{escape(self.prefix)}_{time}"))

    def _finished(self, running: Path) -> Iterator[Path]:
        """Those that may be removed, the oldest first."""
        here = running.resolve()
        return (f for f in self._folders() if f.resolve() != here and _is_finished(f))


def _is_finished(folder: Path) -> bool:
    files = list(folder.glob("*.mcap"))
    return bool(files) and all(_ends_well(file) for file in files)


def _ends_well(file: Path) -> bool:
    with file.open("rb") as opened:
        opened.seek(-min(len(MAGIC), file.stat().st_size), os.SEEK_END)
        return file.stat().st_size > len(MAGIC) and opened.read() == MAGIC


def _remove(folder: Path) -> None:
    """A session's recording; what people put beside it stays."""
    folder = folder.resolve()  # a link is no folder
    for file in [*folder.glob("*.mcap"), folder / "metadata.yaml"]:
        file.unlink(missing_ok=True)
    if not any(folder.iterdir()):
        folder.rmdir()
