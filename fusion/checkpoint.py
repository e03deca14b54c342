"""The checkpoint: all input, written as it comes, so that a killed fusion can resume.

A file of records: length and CRC-32 (little-endian uint32 each), then what came within half a
second, compressed (zlib): a msgpack array of messages, each an array of key and payload. Damage
costs one record; damaged or truncated ones are skipped up to the next sound one. Reading it again
through the pipeline gives the same map under the same UUID. The file is only ever appended to:
another kind of file is kept under another name, and so is a map that is given up. `map_storage`
goes on in another file once this one is long, and removes those of a past that is summarised.
"""

import logging
import mmap
import os
import re
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import msgspec

from trigpoint.base.clock import Clock, to_ns
from trigpoint.base.errors import OperationError

CHECKPOINT = "checkpoint.bin"
"""Its name in the folder of a map."""
PAST = "past.bin"
"""The name of the summary of what came before it (`past_file`)."""
_FULL = re.compile(r"checkpoint-([0-9]{6})\.bin")
_MAGIC, _EARLIER = b"trigpoint-checkpoint/2\n", b"trigpoint-checkpoint/1\n"
_HEAD = struct.Struct("<II")
_FLUSH_NS = to_ns(0.5)
_MOST_RECORD = 16 * 1024 * 1024
_MOST_WAITING = 64 * 1024
# zlib's output begins with this, and no CDR message does.
_COMPRESSED = b"\x78"
# A record's body begins so: compressed, or in earlier files one message, a msgpack array of two
# that begins with a text of up to 255 bytes.
_BODY = re.compile(rb"\x78|\x92[\xa0-\xbf\xd9]")

_log = logging.getLogger(__name__)

_Messages = list[tuple[str, bytes]]
_MESSAGE = msgspec.msgpack.Decoder(tuple[str, bytes])
_MESSAGES = msgspec.msgpack.Decoder(_Messages)


class Checkpoint:
    """An open checkpoint file; used by one thread.

    `trouble`: why what comes now is not stored, "" while all is well; what was written before stays
    valid, and writing goes on once there is room. `written_ns`: when the file was last written to,
    Unix time; 0 where it is new.
    """

    def __init__(self, path: Path, clock: Clock) -> None:
        self._path, self._clock = path, clock
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if path.exists() and not _is_ours(path):
                _log.error("%s is not a checkpoint; it is kept as %s", path, set_aside(path))
            self._open()
        except OSError as reason:
            raise OperationError(
                f"{path}: the checkpoint cannot be written ({reason.strerror}); give another --out"
            ) from None
        self._flushed_ns = clock.elapsed_ns()
        self._unkept = 0
        self.trouble = ""

    def _open(self) -> None:
        self._file = self._path.open("ab", buffering=0)
        self._length = self._file.tell()
        self.written_ns = os.fstat(self._file.fileno()).st_mtime_ns if self._length else 0
        self._waiting = bytearray() if self._length else bytearray(_MAGIC)
        self._messages = _Messages()
        self._bytes = 0  # of them

    def records(self) -> Iterator[tuple[str, bytes]]:
        """(key, payload) of what was in the file when it was opened; it may be written meanwhile,
        but not restarted."""
        return read_checkpoint(self._path, self._length)

    def write(self, key: str, payload: bytes) -> bool:
        """Append a message; it is on the disk within half a second and a call of `flush`. False
        where the disk takes nothing now."""
        self._messages.append((key, payload))
        self._bytes += len(payload)
        if self._bytes > _MOST_WAITING:
            self._try(self._synchronise)
        return not self.trouble

    def flush(self) -> None:
        """Hand what was written to the disk, at most twice a second."""
        if self._clock.elapsed_ns() - self._flushed_ns >= _FLUSH_NS:
            self._flushed_ns = self._clock.elapsed_ns()
            self._try(self._synchronise)

    def restart(self) -> None:
        """Begin a new file; the old one is kept under another name."""
        self.close()
        self._try(self._begin_anew)

    def continue_in_another(self, full: Path) -> None:
        """Go on in a new file; the one so far gets the name `full`."""
        self.close()
        self._try(lambda: self._path.rename(full))
        self._try(self._open)

    def _begin_anew(self) -> None:
        if self._path.exists():
            _log.info("the map before is kept as %s", set_aside(self._path))
        self._open()
        self._synchronise()  # raises where not even the head of a new file is taken
        self.trouble, self._unkept = "", 0  # what is missing is missing in the map before

    def close(self) -> None:
        self._try(self._synchronise)
        with suppress(OSError):  # told already
            self._file.close()

    def _synchronise(self) -> None:
        waiting, count = self._waiting, len(self._messages)
        if count:
            body = zlib.compress(msgspec.msgpack.encode(self._messages), zlib.Z_BEST_SPEED)
            waiting += _HEAD.pack(len(body), zlib.crc32(body)) + body
        # Half of it may be written where the disk is full; that is passed over when it is read.
        self._waiting, self._messages, self._bytes = bytearray(), _Messages(), 0
        try:
            if self._file.closed:  # the disk did not take another file
                self._file = self._path.open("ab", buffering=0)
            while waiting:
                del waiting[: self._file.write(waiting)]
            os.fdatasync(self._file.fileno())
        except (OSError, ValueError):
            self._unkept += count
            raise
        if self.trouble and count:
            _log.warning("%s is written again; %d messages are missing", self._path, self._unkept)
            self.trouble, self._unkept = "", 0

    def _try(self, work: Callable[[], object]) -> None:
        """Do work on the disk; where that fails, set `trouble`."""
        try:
            work()
        except (OSError, ValueError) as reason:  # ValueError: closed
            why = reason.strerror if isinstance(reason, OSError) else str(reason)
            self.trouble = (
                f"{self._path}: the checkpoint cannot be written now ({why}); fusion goes on, "
                "but after a restart it will know only what came before; make room"
            )


def has_map(folder: Path) -> bool:
    """Whether a folder has a map to go on from."""
    files = [*full_files(folder), folder / CHECKPOINT]
    is_any = any(next(read_checkpoint(path), None) is not None for path in files)
    return is_any or (folder / PAST).exists()


def full_files(folder: Path) -> list[Path]:
    """The files of a folder's checkpoint before the one that is written, in order."""
    return sorted(path for path in folder.glob("*.bin") if _FULL.fullmatch(path.name))


def next_full_file(folder: Path) -> Path:
    """The name of the next of these."""
    numbers = [int(path.stem.rpartition("-")[2]) for path in full_files(folder)]
    return folder / f"checkpoint-{max(numbers, default=0) + 1:06}.bin"


def read_checkpoint(path: Path, until: int | None = None) -> Iterator[tuple[str, bytes]]:
    """(key, payload) of every message of a sound record in a file's first `until` bytes; nothing
    where there is no file."""
    for record in _records(path, until):
        yield from record.messages


def set_aside(path: Path) -> Path:
    """Rename a file to the next free name; returns that name."""
    number = 1
    while (aside := path.with_name(f"{path.stem}.{number}{path.suffix}")).exists():
        number += 1
    path.rename(aside)
    return aside


def _is_ours(path: Path) -> bool:
    """Whether a file is a checkpoint or empty; one whose head is damaged has records all the
    same."""
    with path.open("rb") as file:
        head = file.read(len(_MAGIC))
    return not head or head in (_MAGIC, _EARLIER) or next(_records(path), None) is not None


class _Record(NamedTuple):
    start: int
    end: int
    messages: _Messages


def _records(path: Path, until: int | None = None) -> Iterator[_Record]:
    """The sound records of a file, of its first `until` bytes; what is not sound is logged.

    Raises OperationError where the file cannot be read.
    """
    try:
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size if until is None else until
            if not size:
                return
            with mmap.mmap(file.fileno(), size, access=mmap.ACCESS_READ) as data:
                yield from _sound(path, data)
    except FileNotFoundError:
        return
    except OSError as reason:
        raise OperationError(
            f"{path}: the checkpoint cannot be read ({reason.strerror}); give another --out"
        ) from None


def _sound(path: Path, data: mmap.mmap) -> Iterator[_Record]:
    start = len(_MAGIC) if data[: len(_MAGIC)] in (_MAGIC, _EARLIER) else 0
    while start < len(data):
        record = _record_at(data, start)
        if record is None:
            record = _next_record(data, start)
            end = len(data) if record is None else record.start
            _log.warning(
                "%s: %d bytes at %d are damaged or were cut off; they are skipped",
                path,
                end - start,
                start,
            )
        if record is None:
            return
        yield record
        start = record.end


def _record_at(data: mmap.mmap, start: int) -> _Record | None:
    """The sound record that begins there; None where there is none."""
    body_at = start + _HEAD.size
    if body_at > len(data):
        return None
    length, checksum = _HEAD.unpack_from(data, start)
    end = body_at + length
    if length > _MOST_RECORD or end > len(data):
        return None
    body = data[body_at:end]
    if zlib.crc32(body) != checksum:
        return None
    try:
        return _Record(start, end, _messages_of(body))
    except (msgspec.DecodeError, zlib.error):
        return None


def _messages_of(body: bytes) -> _Messages:
    """The messages of a record; raise DecodeError or zlib.error where there are none."""
    if body.startswith(_COMPRESSED):
        return _MESSAGES.decode(zlib.decompress(body))
    key, payload = _MESSAGE.decode(body)  # of an earlier file
    return [(key, zlib.decompress(payload) if payload.startswith(_COMPRESSED) else payload)]


def _next_record(data: mmap.mmap, start: int) -> _Record | None:
    """The first sound record after a damaged place."""
    for found in _BODY.finditer(data, start + _HEAD.size + 1):
        record = _record_at(data, found.start() - _HEAD.size)
        if record is not None:
            return record
    return None
