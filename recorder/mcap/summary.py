"""A finished file's index, by the summary at its end."""

import struct
from mmap import mmap
from pathlib import Path
from typing import IO

from isal.isal_zlib import crc32
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, ChunkIndex, Metadata, MetadataIndex

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
from .records import HEAD, MAGIC

_FOOTER = struct.Struct("<QQI")
_TAIL = HEAD.size + _FOOTER.size + len(MAGIC)


def read_summary(path: Path, file: IO[bytes]) -> McapIndex | None:
    """The index; None where the file's end is missing or damaged, or does not say all."""
    size = file.seek(0, 2)
    if size < _TAIL + len(MAGIC):
        return None
    file.seek(size - _TAIL)
    tail = file.read(_TAIL)
    opcode, length = HEAD.unpack_from(tail)
    start, _, checksum = _FOOTER.unpack_from(tail, HEAD.size)
    is_footer = opcode == Opcode.FOOTER and length == _FOOTER.size and tail.endswith(MAGIC)
    if not is_footer or not len(MAGIC) < start <= size - _TAIL:
        return None
    file.seek(start)
    summary = file.read(size - _TAIL - start)
    if checksum and crc32(tail[: HEAD.size + 16], crc32(summary)) != checksum:
        return None
    try:
        return _index(path, file, summary)
    except (ValueError, struct.error, EOFError, UnicodeDecodeError, IndexError):
        return None


def summary_is_sound(data: bytes | mmap) -> bool:
    """Whether the checksum of a whole file's summary holds; 0 says that there is none."""
    tail = data[-_TAIL:]
    start, _, checksum = _FOOTER.unpack_from(tail, HEAD.size)
    if not checksum:
        return True
    summary = data[start or len(data) - _TAIL : len(data) - _TAIL]
    return crc32(tail[: HEAD.size + 16], crc32(summary)) == checksum


def _index(path: Path, file: IO[bytes], summary: bytes) -> McapIndex | None:
    index = McapIndex(path)
    chunks: list[ChunkIndex] = []
    attachments: list[AttachmentIndex] = []
    notes: list[MetadataIndex] = []
    message_count: int | None = None
    position = 0
    while position < len(summary):
        opcode, length = HEAD.unpack_from(summary, position)
        position += HEAD.size
        body = summary[position : position + length]
        position += length
        if opcode == Opcode.CHANNEL:
            take_channel(index, body)
        elif opcode == Opcode.SCHEMA:
            take_schema(index, body)
        elif opcode == Opcode.CHUNK_INDEX:
            chunks.append(ChunkIndex.read(stream(body)))
        elif opcode == Opcode.ATTACHMENT_INDEX:
            attachments.append(AttachmentIndex.read(stream(body)))
        elif opcode == Opcode.METADATA_INDEX:
            notes.append(MetadataIndex.read(stream(body)))
        elif opcode == Opcode.STATISTICS:
            (message_count,) = struct.unpack_from("<Q", body)
    if message_count != 0 and (not chunks or not index.channels):
        return None  # a summary may leave these out: then the file is walked
    for chunk in sorted(chunks, key=lambda one: one.chunk_start_offset):
        _take_chunk(index, file, chunk)
    for note in notes:
        _take_note(index, file, note)
    for attachment in attachments:
        _take_attached(index, file, attachment)
    return index


def _take_chunk(index: McapIndex, file: IO[bytes], chunk: ChunkIndex) -> None:
    offset, length = chunk.chunk_start_offset + HEAD.size, chunk.chunk_length - HEAD.size
    span = ChunkSpan(offset, length, chunk.message_start_time, chunk.message_end_time)
    file.seek(chunk.chunk_start_offset + chunk.chunk_length)
    counts = counts_in(file.read(chunk.message_index_length))  # a file may have none
    if counts and counts.keys() == chunk.message_index_offsets.keys():
        span.counts = counts
    else:
        try:
            look_into(index, span, read_chunk(file, span))
        except ValueError as reason:
            index.problems.append(str(reason))
            return
    index.chunks.append(span)


def _take_note(index: McapIndex, file: IO[bytes], place: MetadataIndex) -> None:
    file.seek(place.offset + HEAD.size)
    try:
        note = Metadata.read(stream(file.read(place.length - HEAD.size)))
    except Exception as reason:  # noqa: BLE001 - whatever the bytes lead the library to
        index.problems.append(f"the metadata at byte {place.offset} are damaged ({reason})")
        return
    index.metadata[note.name] = note.metadata


def _take_attached(index: McapIndex, file: IO[bytes], place: AttachmentIndex) -> None:
    file.seek(place.offset + HEAD.size)
    try:
        take_attachment(index, file.read(place.length - HEAD.size), place.offset)
    except Exception as reason:  # noqa: BLE001 - whatever the bytes lead the library to
        text = str(reason) if isinstance(reason, ValueError) else f"{place.name} is damaged"
        index.problems.append(text)
