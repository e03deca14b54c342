"""An MCAP file as an index of chunks, read without decoding any message.

Record layouts: the MCAP specification.
"""

import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import IO, NamedTuple

from isal.isal_zlib import crc32
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Schema
from mcap.stream_reader import get_chunk_data_stream
from msgspec import Struct, field

from trigpoint.contract.cdr import fault_in

from .records import HEAD, MESSAGE, MESSAGE_FIELDS

_MESSAGE_INDEX = struct.Struct("<HI")


class RawMessage(NamedTuple):
    """One message as the file has it; a tuple, since a session holds a hundred thousand."""

    log_ns: int
    published_ns: int
    channel: int
    payload: bytes
    sequence: int


class ChunkSpan(Struct):
    """Where a chunk's content stands in the file, its log times and its messages by channel;
    `is_loose`: whether these are records outside of any chunk, as they stand in the file."""

    offset: int
    length: int
    start_ns: int
    end_ns: int
    counts: dict[int, int] = field(default_factory=dict)
    is_loose: bool = False


class McapIndex(Struct):
    """What a file holds; `problems` says in words what of it is damaged or missing.

    `metadata`: the metadata records by name, the last one of a name.
    """

    path: Path
    channels: dict[int, Channel] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    chunks: list[ChunkSpan] = field(default_factory=list)
    attachments: dict[str, bytes] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)

    @property
    def problem(self) -> str:
        """All problems in one line, "" where there is none."""
        told = "; ".join(self.problems[:_TOLD])
        more = len(self.problems) - _TOLD
        return f"{told}; and {more} more" if more > 0 else told

    def type_of(self, channel: int) -> str:
        """A channel's type; what none of ours can be says in which form it is."""
        encoding = self.channels[channel].message_encoding
        schema = self.schemas.get(self.channels[channel].schema_id)
        name = schema.name if schema else "message without a type"
        if encoding == "cdr":
            return name
        return f"{_FORMS.get(encoding, f'message in «{encoding}»')} ({name}) in MCAP"


def is_of_ros2(kind: str) -> bool:
    """Whether a type, as `McapIndex.type_of` has it, is one that ROS 2's messages have."""
    return "/msg/" in kind and " " not in kind


_TOLD = 3
_FORMS = {"ros1": "ROS 1 message", "json": "JSON message", "protobuf": "Protobuf message"}


def read_chunk(file: IO[bytes], span: ChunkSpan) -> bytes:
    """A chunk's records, decompressed and held against its checksum; ValueError where damaged."""
    file.seek(span.offset)
    if span.is_loose:
        return file.read(span.length)
    try:
        chunk = Chunk.read(stream(file.read(span.length)))
        records, length = get_chunk_data_stream(chunk, validate_crc=True)
        content = records.read(length)
    except Exception as reason:  # noqa: BLE001 - each compression raises errors of its own
        raise ValueError(f"the chunk at byte {span.offset} is damaged ({reason})") from None
    if len(content) != chunk.uncompressed_size:
        raise ValueError(f"the chunk at byte {span.offset} is damaged (it is too short)")
    return content


def chunk_messages(records: bytes, channels: set[int]) -> Iterator[RawMessage]:
    """The messages of these channels, in the order of the chunk."""
    position, end = 0, len(records)
    while position < end:
        opcode, length = HEAD.unpack_from(records, position)
        if opcode == Opcode.MESSAGE:
            _, _, channel, sequence, log_ns, published_ns = MESSAGE.unpack_from(records, position)
            if channel in channels:
                start = position + MESSAGE.size
                payload = records[start : start - MESSAGE_FIELDS + length]
                yield RawMessage(log_ns, published_ns, channel, payload, sequence)
        position += HEAD.size + length


def look_into(index: McapIndex, span: ChunkSpan, records: bytes) -> None:
    """Take a chunk's definitions, count its messages, and see from when to when they are: the
    chunk's own head, which says so, has no checksum."""
    position = 0
    span.counts = {}
    times: list[int] = []
    while position < len(records):
        opcode, length = HEAD.unpack_from(records, position)
        start = position + HEAD.size
        if opcode == Opcode.CHANNEL:
            take_channel(index, records[start : start + length])
        elif opcode == Opcode.SCHEMA:
            take_schema(index, records[start : start + length])
        elif opcode == Opcode.MESSAGE:
            _, _, channel, _, log_ns, _ = MESSAGE.unpack_from(records, position)
            span.counts[channel] = span.counts.get(channel, 0) + 1
            times.append(log_ns)
        position = start + length
    if times:
        span.start_ns, span.end_ns = min(times), max(times)


def counts_in(indexes: bytes) -> dict[int, int] | None:
    """Messages by channel that a chunk's message indexes name; None where they are damaged."""
    counts: dict[int, int] = {}
    position = 0
    while position < len(indexes):
        if len(indexes) - position < HEAD.size + _MESSAGE_INDEX.size:
            return None
        opcode, length = HEAD.unpack_from(indexes, position)
        channel, size = _MESSAGE_INDEX.unpack_from(indexes, position + HEAD.size)
        if opcode != Opcode.MESSAGE_INDEX or size % 16 or length != _MESSAGE_INDEX.size + size:
            return None
        if size:
            counts[channel] = size // 16
        position += HEAD.size + length
    return counts


def fault_of(channel: Channel, schema: Schema | None, payload: bytes) -> str:
    """What hinders reading a message as one of its channel's type, so far as that is known."""
    if schema is None or channel.message_encoding != "cdr":
        return ""
    return fault_in(schema.name, payload)


def take_channel(index: McapIndex, body: bytes) -> None:
    channel = Channel.read(stream(body))
    index.channels[channel.id] = channel


def take_schema(index: McapIndex, body: bytes) -> None:
    schema = Schema.read(stream(body))
    index.schemas[schema.id] = schema


def take_attachment(index: McapIndex, body: bytes, offset: int) -> None:
    """Keep an attachment; ValueError where it is damaged."""
    expected = int.from_bytes(body[-4:], "little")
    if expected and expected != crc32(body[:-4]):
        raise ValueError(f"the attachment at byte {offset} is damaged")
    attachment = Attachment.read(stream(body))
    index.attachments[attachment.name] = attachment.data


def stream(body: bytes) -> ReadDataStream:
    """What the mcap package's records are read from."""
    return ReadDataStream(BytesIO(body))
