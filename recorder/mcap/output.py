"""A file written without Python's buffering: written bytes are with the operating system."""

import fcntl
import os
from contextlib import suppress
from pathlib import Path

from trigpoint.base.errors import OperationError

_MOST_PIECES = 1024  # IOV_MAX of Linux

_HANDED_ON = 8 * 2**20  # some tens of milliseconds of disk time


def is_being_written(path: Path) -> bool:
    """Whether a recorder of this machine still writes a file."""
    with path.open("rb") as file, suppress(OSError):  # a file system may have no locks
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


class Output:
    """A new file. Methods raise OperationError if the disk does not take the bytes."""

    def __init__(self, path: Path) -> None:
        """Create the file and its folder; an existing file is never overwritten."""
        self._path = path
        if path.exists():
            raise OperationError(f"{path}: is there already; give another name")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("xb", buffering=0)
        except OSError as reason:
            raise OperationError(
                f"{path}: cannot be created ({reason.strerror}); give another folder with --out"
            ) from None
        with suppress(OSError):
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self.position = self._handed_on = 0

    def write(self, *pieces: bytes) -> None:
        """Append the pieces, in one system call if it takes them all."""
        rest = sum(len(piece) for piece in pieces)
        size = rest
        waiting = [memoryview(piece) for piece in pieces if piece]
        try:
            while rest:
                written = os.writev(self._file.fileno(), waiting[:_MOST_PIECES])
                rest -= written
                while waiting and written >= len(waiting[0]):
                    written -= len(waiting.pop(0))
                if waiting:
                    waiting[0] = waiting[0][written:]
        except OSError as reason:
            raise OperationError(
                f"{self._path}: writing failed ({reason.strerror}) after "
                f"{self.position / 1e6:.1f} MB, which are kept; make room on the disk"
            ) from None
        self.position += size
        self._hand_on()

    def _hand_on(self) -> None:
        """Have the system start writing to the disk, without waiting for it. Otherwise everything
        that a camera sends in five seconds is written at once while `synchronise` waits."""
        if self.position - self._handed_on >= _HANDED_ON and hasattr(os, "posix_fadvise"):
            size = self.position - self._handed_on
            os.posix_fadvise(self._file.fileno(), self._handed_on, size, os.POSIX_FADV_DONTNEED)
            self._handed_on = self.position

    def synchronise(self) -> None:
        """Wait until the disk has everything."""
        try:
            os.fsync(self._file.fileno())
        except OSError as reason:
            raise OperationError(
                f"{self._path}: the disk refuses to synchronise ({reason.strerror}); check it"
            ) from None

    def close(self) -> None:
        """A second time does nothing."""
        if not self._file.closed:
            with suppress(OSError):  # a child that was forked meanwhile would keep the lock
                fcntl.flock(self._file, fcntl.LOCK_UN)
            self._file.close()
