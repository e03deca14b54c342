"""Where a part's standard output and error go."""

from pathlib import Path
from typing import BinaryIO, Protocol

_TAIL_BYTES = 4096
_LONGEST_LINE = 300


class Output(Protocol):
    """What a part says, while it runs and after."""

    def attach(self) -> BinaryIO:
        """The end that a process writes to; the caller closes it once the process has it."""
        ...

    def last_line(self) -> str:
        """The last line that says anything, "" where there is none; asked after an end."""
        ...

    @property
    def where(self) -> str:
        """Where a person reads more of it: « (see …)», "" where all of it was seen."""
        ...


class LogFile:
    def __init__(self, path: Path) -> None:
        self._path = path

    def attach(self) -> BinaryIO:
        return self._path.open("ab")

    def last_line(self) -> str:
        if not self._path.exists():
            return ""
        with self._path.open("rb") as file:
            file.seek(max(0, self._path.stat().st_size - _TAIL_BYTES))
            return last_words(file.read().splitlines())

    @property
    def where(self) -> str:
        return f" (see {self._path})"

    @classmethod
    def of(cls, part: str, directory: Path) -> "LogFile":
        """The log of a part, by its name."""
        return cls(directory / f"{part.replace(' ', '_').replace('/', '_')}.log")


def last_words(lines: list[bytes]) -> str:
    """The last line that says anything, cut where it is long."""
    words = (line.decode(errors="replace").strip() for line in reversed(lines))
    return next((line[:_LONGEST_LINE] for line in words if line), "")
