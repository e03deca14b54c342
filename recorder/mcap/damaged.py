"""The index of a file without a sound end, or without chunks, by a walk over its records.

A damaged head leads nowhere; what is a chunk, an attachment or metadata says its length twice (its
own, and those of its parts), so that the walk finds the next one again.
"""

import json
import mmap
import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import IO

from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema

from trigpoint.contract import cdr

from .channels import CHANNELS
from .file import (
    ChunkSpan,
    McapIndex,
    counts_in,
    look_into,
    read_chunk,
    stream,
    take_attachment,
    take_channel,
    take_schema,
)
from .output import is_being_written
from .records import CHUNK, HEAD, MAGIC, MESSAGE_FIELDS
from .summary import summary_is_sound

_LAST_OPCODE = Opcode.DATA_END
# Opcodes that the walk can take up again at, and a length below 4 GiB.
_CANDIDATE = re.compile(rb"(?=[\x06\x09\x0c].{4}\0\0\0\0)", re.DOTALL)
_MOST_LOOSE = 1 << 22  # bytes that are read at once
_COMPRESSIONS = (b"", b"lz4", b"zstd")


def walk(path: Path, file: IO[bytes]) -> McapIndex:
    """Everything of the file that is sound."""
    index = McapIndex(path)
    with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        end = _walk(index, data)
    if end is not None:
        is_running = is_being_written(index.path)
        text = "it is still being written" if is_running else f"it breaks off at byte {end}"
        index.problems.append(text)
    _look_into_all(index, file)
    _restore_channels(index)
    return index


def _walk(index: McapIndex, data: mmap.mmap) -> int | None:
    """Take every sound record; where they break off, None where the file has an end."""
    position, size = len(MAGIC), len(data)
    while position + HEAD.size <= size:
        opcode, length = HEAD.unpack_from(data, position)
        start = position + HEAD.size
        is_record = 0 < opcode <= _LAST_OPCODE and start + length <= size
        if is_record and opcode == Opcode.FOOTER:
            if not summary_is_sound(data):
                index.problems.append("its summary at the end is damaged")
            return None
        if is_record and _take(index, data, opcode, start, length):
            position = start + length
            continue
        again = _next_sound(data, position + 1)
        if again is None:
            return position
        index.problems.append(f"bytes {position} to {again - 1} are damaged")
        position = again
    return position


def _take(index: McapIndex, data: mmap.mmap, opcode: int, start: int, length: int) -> bool:
    """Keep a record; False where it is damaged so that what follows is uncertain."""
    if opcode == Opcode.MESSAGE:
        return _take_loose(index, start, length)
    if opcode in _SOUND and not _SOUND[opcode](data, start, length):
        return False
    body = data[start : start + length] if opcode != Opcode.CHUNK else b""
    try:
        if opcode == Opcode.CHUNK:
            index.chunks.append(ChunkSpan(start, length, *struct.unpack_from("<QQ", data, start)))
        elif opcode == Opcode.MESSAGE_INDEX:
            _take_counts(index, data, start, length)
        elif opcode == Opcode.CHANNEL:
            take_channel(index, body)
        elif opcode == Opcode.SCHEMA:
            take_schema(index, body)
        elif opcode == Opcode.METADATA:
            note = Metadata.read(stream(body))
            index.metadata[note.name] = note.metadata
        elif opcode == Opcode.ATTACHMENT:
            take_attachment(index, body, start)
    except Exception as reason:  # noqa: BLE001 - whatever the bytes lead the library to
        told = str(reason) if isinstance(reason, ValueError) else f"byte {start}: {reason!r}"
        index.problems.append(told)
    return True


def _take_loose(index: McapIndex, start: int, length: int) -> bool:
    """Keep a message outside of chunks, with those before it; among chunks it is none."""
    spans, begin = index.chunks, start - HEAD.size
    if length < MESSAGE_FIELDS or (spans and not spans[-1].is_loose):
        return False
    if spans and spans[-1].offset + spans[-1].length == begin and spans[-1].length < _MOST_LOOSE:
        spans[-1].length += HEAD.size + length
    else:
        spans.append(ChunkSpan(begin, HEAD.size + length, 0, 0, is_loose=True))
    return True


def _take_counts(index: McapIndex, data: mmap.mmap, start: int, length: int) -> None:
    counts = counts_in(data[start - HEAD.size : start + length])
    if counts and index.chunks:
        index.chunks[-1].counts |= counts


def _look_into_all(index: McapIndex, file: IO[bytes]) -> None:
    sound: list[ChunkSpan] = []
    for span in index.chunks:
        try:
            look_into(index, span, read_chunk(file, span))
        except (ValueError, struct.error) as reason:
            lost = sum(span.counts.values())
            index.problems.append(f"{reason}: {lost or 'its'} messages are lost")
            continue
        except Exception as reason:  # noqa: BLE001 - a definition that the library cannot read
            index.problems.append(f"a definition in the chunk at byte {span.offset}: {reason!r}")
        sound.append(span)
    index.chunks = sound


def _restore_channels(index: McapIndex) -> None:
    """Channels whose own definition is damaged, as far as the metadata name them again."""
    needed = {channel for span in index.chunks for channel in span.counts}
    missing = needed - index.channels.keys()
    named = index.metadata.get(CHANNELS, {})
    for number in sorted(missing):
        text = named.get(str(number))
        if text is None:
            continue
        topic, type_name = json.loads(text)
        schema = 0xFFFF - number  # ours count from 1: no definition has it
        definition = cdr.definition(type_name).encode()
        index.schemas[schema] = Schema(schema, definition, "ros2msg", type_name)
        index.channels[number] = Channel(number, topic, "cdr", {}, schema)
        missing = missing - {number}
    if missing:
        lost = sum(span.counts.pop(c, 0) for span in index.chunks for c in missing)
        index.problems.append(f"{lost} messages of {len(missing)} keys whose definition is lost")


def _next_sound(data: mmap.mmap, position: int) -> int | None:
    for match in _CANDIDATE.finditer(data, position):
        opcode, length = HEAD.unpack_from(data, match.start())
        start = match.start() + HEAD.size
        if start + length <= len(data) and _SOUND[opcode](data, start, length):
            return match.start()
    return None


def _is_chunk(data: mmap.mmap, start: int, length: int) -> bool:
    if length < CHUNK.size + 8:
        return False
    *_, name_length = CHUNK.unpack_from(data, start)
    name = data[start + CHUNK.size : start + CHUNK.size + min(name_length, 8)]
    if name not in _COMPRESSIONS or len(name) != name_length:
        return False
    place = CHUNK.size + name_length
    if length < place + 8:
        return False
    (records,) = struct.unpack_from("<Q", data, start + place)
    return length == place + 8 + records


def _parts(layout: str) -> Callable[[mmap.mmap, int, int], bool]:
    """A check that a record is as long as its parts: «4» is so many bytes, «s» a length of 32 bits
    and as many bytes, «S» the same with 64 bits."""

    def is_sound(data: mmap.mmap, start: int, length: int) -> bool:
        place = 0
        for part in layout.split():
            if part not in "sS":
                place += int(part)
                continue
            prefix = struct.Struct("<I" if part == "s" else "<Q")
            if place + prefix.size > length:
                return False
            place += prefix.size + prefix.unpack_from(data, start + place)[0]
        return place == length

    return is_sound


_SOUND: dict[int, Callable[[mmap.mmap, int, int], bool]] = {
    Opcode.HEADER: _parts("s s"),
    Opcode.FOOTER: _parts("20"),
    Opcode.SCHEMA: _parts("2 s s s"),
    Opcode.CHANNEL: _parts("4 s s s"),
    Opcode.CHUNK: _is_chunk,
    Opcode.MESSAGE_INDEX: _parts("2 s"),
    Opcode.ATTACHMENT: _parts("16 s s S 4"),
    Opcode.METADATA: _parts("s s"),
    Opcode.DATA_END: _parts("4"),
}
"""Whether a record's length is that of its parts."""
