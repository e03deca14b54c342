"""The bytes of MCAP records, by the specification; pure functions.

Our own, since the mcap package's writer has no chunk that ends by time, keeps no log-time order
within one and takes four microseconds a message.
"""

import struct
from collections.abc import Iterable, Mapping

from isal.isal_zlib import crc32
from mcap.opcode import Opcode

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")
"""Opcode and length, before every record's body."""
MESSAGE = struct.Struct("<BQHIQQ")
"""A message's head: opcode, length, channel, sequence, log time, publish time."""
MESSAGE_FIELDS = MESSAGE.size - HEAD.size
CHUNK = struct.Struct("<QQQII")
"""A chunk's start: first and last log time, uncompressed size and checksum, length of a name."""
_U16, _U32, _U64 = struct.Struct("<H"), struct.Struct("<I"), struct.Struct("<Q")


def record(opcode: Opcode, *parts: bytes) -> bytes:
    """One record with its head."""
    body = b"".join(parts)
    return HEAD.pack(opcode, len(body)) + body


def text(value: str) -> bytes:
    """A length-prefixed string."""
    data = value.encode()
    return _U32.pack(len(data)) + data


def header(profile: str, library: str) -> bytes:
    return record(Opcode.HEADER, text(profile), text(library))


def schema(number: int, name: str, encoding: str, data: bytes) -> bytes:
    return record(
        Opcode.SCHEMA, _U16.pack(number), text(name), text(encoding), _U32.pack(len(data)), data
    )


def channel(
    number: int, schema_number: int, topic: str, encoding: str, metadata: Mapping[str, str]
) -> bytes:
    numbers = struct.pack("<HH", number, schema_number)
    return record(Opcode.CHANNEL, numbers, text(topic), text(encoding), _texts(metadata))


def chunk_head(
    times_ns: tuple[int, int], size: int, checksum: int, compression: str, compressed: int
) -> bytes:
    """A chunk record up to its records, which follow with `compressed` bytes."""
    name = compression.encode()
    start = CHUNK.pack(*times_ns, size, checksum, len(name)) + name + _U64.pack(compressed)
    return HEAD.pack(Opcode.CHUNK, len(start) + compressed) + start


def message_index(number: int, entries: bytes) -> bytes:
    """`entries`: pairs of log time and offset in the chunk, 16 bytes each."""
    return record(Opcode.MESSAGE_INDEX, _U16.pack(number), _U32.pack(len(entries)), entries)


def chunk_index(
    times_ns: tuple[int, int],
    place: tuple[int, int],
    indexes: Mapping[int, int],
    indexes_length: int,
    compression: str,
    sizes: tuple[int, int],
) -> bytes:
    """`place`: the chunk's offset and length in the file; `sizes`: compressed, uncompressed."""
    return record(
        Opcode.CHUNK_INDEX,
        struct.pack("<QQQQ", *times_ns, *place),
        _numbers(indexes, "<HQ"),
        _U64.pack(indexes_length),
        text(compression),
        struct.pack("<QQ", *sizes),
    )


def attachment(name: str, media_type: str, data: bytes, time_ns: int) -> bytes:
    body = b"".join(
        (
            struct.pack("<QQ", time_ns, time_ns),
            text(name),
            text(media_type),
            _U64.pack(len(data)),
            data,
        )
    )
    return record(Opcode.ATTACHMENT, body, _U32.pack(crc32(body)))


def attachment_index(
    name: str, media_type: str, size: int, time_ns: int, place: tuple[int, int]
) -> bytes:
    numbers = struct.pack("<QQQQQ", *place, time_ns, time_ns, size)
    return record(Opcode.ATTACHMENT_INDEX, numbers, text(name), text(media_type))


def metadata(name: str, values: Mapping[str, str]) -> bytes:
    return record(Opcode.METADATA, text(name), _texts(values))


def metadata_index(name: str, place: tuple[int, int]) -> bytes:
    return record(Opcode.METADATA_INDEX, struct.pack("<QQ", *place), text(name))


def statistics(
    counts: Mapping[int, int],
    times_ns: tuple[int, int],
    *,
    schemas: int,
    attachments: int,
    metadata_records: int,
    chunks: int,
) -> bytes:
    numbers = struct.pack(
        "<QHIIIIQQ",
        sum(counts.values()),
        schemas,
        len(counts),
        attachments,
        metadata_records,
        chunks,
        *times_ns,
    )
    return record(Opcode.STATISTICS, numbers, _numbers(counts, "<HQ"))


def summary_offset(opcode: Opcode, start: int, length: int) -> bytes:
    return record(Opcode.SUMMARY_OFFSET, struct.pack("<BQQ", opcode, start, length))


def data_end() -> bytes:
    """Without a checksum of all that is before it: chunks and attachments have their own, and a
    second pass over every picture costs a tenth of the disk's pace."""
    return record(Opcode.DATA_END, _U32.pack(0))


def footer(summary: bytes, summary_start: int, offsets_start: int) -> bytes:
    """The footer, whose checksum covers the summary and the footer's own start."""
    start = HEAD.pack(Opcode.FOOTER, 20) + struct.pack("<QQ", summary_start, offsets_start)
    return start + _U32.pack(crc32(start, crc32(summary)))


def _texts(values: Mapping[str, str]) -> bytes:
    return _sized(text(name) + text(value) for name, value in values.items())


def _numbers(values: Mapping[int, int], layout: str) -> bytes:
    return _sized(struct.pack(layout, *item) for item in values.items())


def _sized(items: Iterable[bytes]) -> bytes:
    body = b"".join(items)
    return _U32.pack(len(body)) + body
