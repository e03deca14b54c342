"""The checkpoint: everything that came in, written as it comes, so that a killed fusion goes on.

A file of records: length and CRC-32 (little-endian uint32 each), then a msgpack array of key and
payload. Reading it again through the pipeline gives the same map under the same UUID. The end of a
file that was cut off in a record is left out.
"""

import logging
import os
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import msgspec

from trigpoint.clock import Clock, to_ns
from trigpoint.errors import OperationError

_MAGIC = b"trigpoint-checkpoint/1\n"
_HEAD = struct.Struct("<II")
_FLUSH_NS = to_ns(0.5)
_MOST_RECORD = 16 * 1024 * 1024

_log = logging.getLogger(__name__)


class Checkpoint:
    """An open checkpoint file; used by one thread.

    `trouble`: why nothing is written any more since the disk failed, "" while all is well. What was
    written before stays good.
    """

    def __init__(self, path: Path, clock: Clock) -> None:
        self._path, self._clock = path, clock
        sound = self._sound = _sound_length(path)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("r+b" if path.exists() else "w+b")
        except OSError as reason:
            raise OperationError(
                f"{path}: the checkpoint cannot be written ({reason.strerror}); give another --out"
            ) from None
        self._file.truncate(sound)
        self._file.seek(sound)
        if sound == 0:
            self._file.write(_MAGIC)
        self._flushed_ns = clock.elapsed_ns()
        self.trouble = ""

    def records(self) -> Iterator[tuple[str, bytes]]:
        """(key, payload) of what was in the file when it was opened; it may be written meanwhile,
        but not restarted."""
        if self._sound:
            for _, key, payload in _records(self._path, self._sound):
                yield key, payload

    def write(self, key: str, payload: bytes) -> bool:
        """Append a message; it is on the disk within half a second and a call of `flush`. False
        where it is not kept."""
        body = msgspec.msgpack.encode((key, payload))
        self._try(lambda: self._file.write(_HEAD.pack(len(body), zlib.crc32(body)) + body))
        return not self.trouble

    def flush(self) -> None:
        """Hand what was written to the disk, at most twice a second."""
        if self._clock.elapsed_ns() - self._flushed_ns >= _FLUSH_NS:
            self._flushed_ns = self._clock.elapsed_ns()
            self._try(self._synchronise)

    def restart(self) -> None:
        """Forget everything."""
        with suppress(OSError):  # what waits to be written is not wanted any more
            self._file.close()
        self.trouble = ""
        self._try(self._begin_anew)

    def _begin_anew(self) -> None:
        self._file = self._path.open("w+b")
        self._file.write(_MAGIC)
        self._synchronise()

    def close(self) -> None:
        self._try(self._synchronise)
        with suppress(OSError):  # told already
            self._file.close()

    def _synchronise(self) -> None:
        self._file.flush()
        os.fdatasync(self._file.fileno())

    def _try(self, work: Callable[[], object]) -> None:
        """Do what needs the disk; not after that failed: nothing behind half a record is read."""
        if self.trouble:
            return
        try:
            work()
        except OSError as reason:
            self.trouble = (
                f"{self._path}: the checkpoint cannot be written any more ({reason.strerror}); "
                "fusion goes on, but started again it will know only what came before; make room"
            )


def read_checkpoint(path: Path) -> Iterator[tuple[str, bytes]]:
    """(key, payload) of every sound record; nothing where there is no file."""
    for _, key, payload in _records(path):
        yield key, payload


def _sound_length(path: Path) -> int:
    """How many bytes of the file are whole records, with the file's head."""
    length = 0
    for end, _, _ in _records(path):
        length = end
    return length


def _records(path: Path, until: int | None = None) -> Iterator[tuple[int, str, bytes]]:
    """(end of the record, key, payload), up to the one that ends at `until`.

    Raises OperationError where the file cannot be read.
    """
    try:
        file = path.open("rb")
    except FileNotFoundError:
        return
    except OSError as reason:
        raise OperationError(
            f"{path}: the checkpoint cannot be read ({reason.strerror}); give another --out"
        ) from None
    with file:
        magic = file.read(len(_MAGIC))
        if magic != _MAGIC:
            if magic:
                _log.error("%s is no checkpoint; it is replaced", path)
            return
        decoder = msgspec.msgpack.Decoder(tuple[str, bytes])
        end = len(_MAGIC)
        while end != until and len(head := file.read(_HEAD.size)) == _HEAD.size:
            length, checksum = _HEAD.unpack(head)
            body = file.read(length) if length <= _MOST_RECORD else b""
            if len(body) != length or zlib.crc32(body) != checksum:
                _log.warning("%s ends in a record that was cut off; that one is left out", path)
                return
            key, payload = decoder.decode(body)
            end += _HEAD.size + length
            yield end, key, payload
