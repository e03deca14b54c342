"""An MCAP file as an index of chunks, read without decoding any message.

The file is walked from its start by its records' headers, sound or not: one way of reading serves a
finished file and one whose recorder was killed (no footer), which is read as far as it is complete.
Record layouts: the MCAP specification.
"""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import IO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Schema
from mcap.stream_reader import get_chunk_data_stream

from trigpoint.errors import RecordingError

MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")
_CHUNK_TIMES = struct.Struct("<QQ")
_MESSAGE_INDEX = struct.Struct("<HI")
_MESSAGE = struct.Struct("<BQHIQQ")
_MESSAGE_FIELDS = _MESSAGE.size - _HEAD.size
_LAST_OPCODE = Opcode.DATA_END
_LARGEST_RECORD = 4 * 2**30


class RawMessage(NamedTuple):
    """One message as the file has it; a tuple, since a session holds a hundred thousand."""

    log_ns: int
    published_ns: int
    channel: int
    payload: bytes


@dataclass(slots=True)
class ChunkSpan:
    """Where a chunk's content stands in the file, its log times and its messages by channel."""

    offset: int
    length: int
    start_ns: int
    end_ns: int
    counts: dict[int, int] = field(default_factory=dict)


@dataclass(slots=True)
class McapIndex:
    """What a file holds. `problem` says in words why it is not complete, "" where it is."""

    path: Path
    channels: dict[int, Channel] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    chunks: list[ChunkSpan] = field(default_factory=list)
    attachments: dict[str, bytes] = field(default_factory=dict)
    problem: str = ""


def read_index(path: Path) -> McapIndex:
    """Walk the file; raise RecordingError where it is no MCAP file at all."""
    index = McapIndex(path)
    try:
        with path.open("rb") as file:
            _check_magic(path, file)
            size = file.seek(0, 2)
            _walk(index, file, size)
            _complete_counts(index, file)
    except OSError as reason:
        raise RecordingError(f"{path}: cannot be read ({reason.strerror}); check it") from None
    return index


def read_chunk(file: IO[bytes], span: ChunkSpan) -> bytes:
    """A chunk's records, decompressed and held against its checksum; ValueError where damaged."""
    file.seek(span.offset)
    try:
        chunk = Chunk.read(_stream(file.read(span.length)))
        stream, length = get_chunk_data_stream(chunk, validate_crc=True)
    except Exception as reason:  # noqa: BLE001 - each compression raises errors of its own
        raise ValueError(f"the chunk at byte {span.offset} is damaged ({reason})") from None
    return stream.read(length)


def chunk_messages(records: bytes, channels: set[int]) -> Iterator[RawMessage]:
    """The messages of these channels, in the order of the chunk."""
    position, end = 0, len(records)
    while position < end:
        opcode, length = _HEAD.unpack_from(records, position)
        if opcode == Opcode.MESSAGE:
            _, _, channel, _, log_ns, published_ns = _MESSAGE.unpack_from(records, position)
            if channel in channels:
                start = position + _MESSAGE.size
                payload = records[start : start - _MESSAGE_FIELDS + length]
                yield RawMessage(log_ns, published_ns, channel, payload)
        position += _HEAD.size + length


def _check_magic(path: Path, file: IO[bytes]) -> None:
    start = file.read(len(MAGIC))
    if not start:
        raise RecordingError(f"{path}: the file is empty; nothing was recorded into it")
    if start != MAGIC:
        raise RecordingError(f"{path}: this is no MCAP file; give a session that was recorded")


def _walk(index: McapIndex, file: IO[bytes], size: int) -> None:
    position = len(MAGIC)
    while True:
        file.seek(position)
        head = file.read(_HEAD.size)
        opcode, length = _HEAD.unpack(head) if len(head) == _HEAD.size else (0, 0)
        position += _HEAD.size
        if not 0 < opcode <= _LAST_OPCODE or length > _LARGEST_RECORD or position + length > size:
            index.problem = f"it breaks off at byte {position - _HEAD.size}"
            return
        if opcode == Opcode.FOOTER:
            return
        _take_record(index, file, opcode, position, length)
        position += length


def _take_record(index: McapIndex, file: IO[bytes], opcode: int, offset: int, length: int) -> None:
    if opcode == Opcode.CHUNK:
        start_ns, end_ns = _CHUNK_TIMES.unpack(file.read(_CHUNK_TIMES.size))
        index.chunks.append(ChunkSpan(offset, length, start_ns, end_ns))
    elif opcode == Opcode.MESSAGE_INDEX and index.chunks:
        channel, size = _MESSAGE_INDEX.unpack(file.read(_MESSAGE_INDEX.size))
        index.chunks[-1].counts[channel] = size // 16
    elif opcode == Opcode.CHANNEL:
        _take_channel(index, file.read(length))
    elif opcode == Opcode.SCHEMA:
        _take_schema(index, file.read(length))
    elif opcode == Opcode.ATTACHMENT:
        _take_attachment(index, file.read(length), offset)
    elif opcode == Opcode.MESSAGE:
        raise RecordingError(
            f"{index.path}: its messages are not in chunks; write it again with an MCAP tool"
        )


def _take_channel(index: McapIndex, body: bytes) -> None:
    channel = Channel.read(_stream(body))
    index.channels[channel.id] = channel


def _take_schema(index: McapIndex, body: bytes) -> None:
    schema = Schema.read(_stream(body))
    index.schemas[schema.id] = schema


def _take_attachment(index: McapIndex, body: bytes, offset: int) -> None:
    expected = int.from_bytes(body[-4:], "little")
    if expected and expected != zlib.crc32(body[:-4]):
        raise RecordingError(f"{index.path}: the attachment at byte {offset} is damaged")
    attachment = Attachment.read(_stream(body))
    index.attachments[attachment.name] = attachment.data


def _complete_counts(index: McapIndex, file: IO[bytes]) -> None:
    """Look into the chunks that the file's own indexes do not describe.

    A chunk holds the definitions of its new channels; a finished file repeats them at its end.
    """
    sound: list[ChunkSpan] = []
    for span in index.chunks:
        is_described = span.counts and index.channels.keys() >= span.counts.keys()
        if index.problem or not is_described:
            try:
                _look_into(index, span, read_chunk(file, span))
            except ValueError as reason:
                index.problem = str(reason)
                break
        sound.append(span)
    index.chunks = sound


def _look_into(index: McapIndex, span: ChunkSpan, records: bytes) -> None:
    position = 0
    span.counts = {}
    while position < len(records):
        opcode, length = _HEAD.unpack_from(records, position)
        start = position + _HEAD.size
        if opcode == Opcode.CHANNEL:
            _take_channel(index, records[start : start + length])
        elif opcode == Opcode.SCHEMA:
            _take_schema(index, records[start : start + length])
        elif opcode == Opcode.MESSAGE:
            (channel,) = struct.unpack_from("<H", records, start)
            span.counts[channel] = span.counts.get(channel, 0) + 1
        position = start + length


def _stream(body: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(body))
