"""Writes an MCAP file by the contract: profile ros2, CDR, full definitions, checksums."""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, Self

from mcap.opcode import Opcode

from trigpoint import __version__
from trigpoint.contract import cdr
from trigpoint.contract.topics import Topic, topic_of

from . import records
from .channels import (
    ATTACHED,
    CHANNELS,
    attached,
    attached_topic,
    attachment_in,
    quality_of_service,
)
from .chunk import Compression, Pending, chunk, compressor
from .output import Output

CHUNK_BYTES = 4 * 2**20
"""A chunk is closed at this size, which limits the damage of one bad byte and a reader's memory.
Pictures of a mebibyte are written a fifth faster in fours than one by one."""

__all__ = ["CHUNK_BYTES", "McapWriter", "Message", "quality_of_service"]


class Message(NamedTuple):
    """One message on its way into the file."""

    log_ns: int
    published_ns: int
    topic: Topic
    key: str
    payload: bytes
    attachment: bytes


class McapWriter:
    """An MCAP file being written, by one thread.

    Every method raises OperationError if the disk does not take the bytes; the file then remains
    readable up to its last complete chunk.
    """

    def __init__(self, path: Path, *, compression: Compression = Compression.ZSTD) -> None:
        """Create the file and its folder; raise OperationError if the file exists already."""
        self.path = path
        self._output = Output(path)
        self._compression, self._compress = compression, compressor(compression)
        self._keys: list[str] = []
        self._types: list[str] = []
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._definitions: dict[str, list[bytes]] = {"schema": [], "channel": []}
        self._new_definitions: list[bytes] = []
        self._pending: list[Pending] = []
        self._pending_bytes = 0
        self._written: dict[int, int] = {}
        self._first_ns: int | None = None
        self._last_ns = 0
        self._summary: dict[Opcode, list[bytes]] = {}
        self._output.write(records.MAGIC + records.header("ros2", f"trigpoint {__version__}"))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, error: type[BaseException] | None, *_: object) -> None:
        """Finish the file, or abandon it where something was raised."""
        if error is None:
            self.finish()
        else:
            self.abandon()

    @property
    def counts(self) -> dict[str, int]:
        """Number of messages in the file, by key."""
        counts: dict[str, int] = {}
        for number, count in sorted(self._written.items()):
            if self._types[number - 1] != ATTACHED:
                key = self._keys[number - 1]
                counts[key] = counts.get(key, 0) + count
        return counts

    @property
    def types(self) -> dict[str, str]:
        """The type of each key, the last one where it has several."""
        return dict(zip(self._keys, self._types, strict=True))

    @property
    def size(self) -> int:
        """The file's size so far, bytes."""
        return self._output.position

    @property
    def times_ns(self) -> tuple[int, int]:
        """The first and the last log time in the file, 0 if there is none."""
        return self._first_ns or 0, self._last_ns

    def unwritten(self) -> list[Message]:
        """Messages of the contract's keys that are waiting for their chunk."""
        messages, attachment = [], b""
        for log_ns, published_ns, channel, payload in self._pending:
            key = self._keys[channel - 1]
            if self._types[channel - 1] == ATTACHED:
                attachment = attachment_in(payload)
            elif topic := topic_of(key):
                messages.append(Message(log_ns, published_ns, topic, key, payload, attachment))
                attachment = b""
        return messages

    def add(
        self,
        topic: Topic,
        key: str,
        payload: bytes,
        *,
        log_ns: int,
        published_ns: int,
        attachment: bytes = b"",
    ) -> None:
        """Append one message; its chunk is written when it is full or on `flush`."""
        self.extend([Message(log_ns, published_ns, topic, key, payload, attachment)])

    def extend(self, messages: Sequence[Message]) -> None:
        """Append many messages, like `add` for each."""
        channels = self._channels
        for message in messages:
            if message[3] not in channels:
                self._register(message.key, message.topic)
        if any(message.attachment for message in messages):
            rows = list(self._with_attachments(messages))
        else:
            rows = [(m[0], m[1], channels[m[3]], m[4]) for m in messages]
        self.append(rows)

    def attach(self, name: str, data: bytes, media_type: str, *, time_ns: int) -> None:
        """Append a file."""
        content = records.attachment(name, media_type, data, time_ns)
        place = self._output.position, len(content)
        self._output.write(content)
        index = records.attachment_index(name, media_type, len(data), time_ns, place)
        self._remember(Opcode.ATTACHMENT_INDEX, index)

    def note(self, name: str, values: Mapping[str, str]) -> None:
        """Append a metadata record."""
        content = records.metadata(name, values)
        index = records.metadata_index(name, (self._output.position, len(content)))
        self._output.write(content)
        self._remember(Opcode.METADATA_INDEX, index)

    def flush(self) -> None:
        """Close the chunk and pass it to the operating system: a kill no longer loses it."""
        if not self._pending:
            return
        one = chunk(
            b"".join(self._new_definitions),
            self._pending,
            self._written,
            self._compress,
            self._compression,
        )
        if self._new_definitions:
            self._note_channels()
        start = self._output.position
        self._output.write(*one.content)
        index = records.chunk_index(
            one.times_ns,
            (start, one.length),
            {number: start + offset for number, offset in one.indexes.items()},
            one.indexes_length,
            one.compression,
            one.sizes,
        )
        self._remember(Opcode.CHUNK_INDEX, index)
        for number, count in one.counts.items():
            self._written[number] = self._written.get(number, 0) + count
        first_ns, last_ns = one.times_ns
        self._first_ns = first_ns if self._first_ns is None else min(self._first_ns, first_ns)
        self._last_ns = max(self._last_ns, last_ns)
        self._pending, self._pending_bytes, self._new_definitions = [], 0, []

    def synchronise(self) -> None:
        """Wait until the disk has everything flushed: a power cut no longer loses it."""
        self._output.synchronise()

    def finish(self) -> None:
        """Write the rest and the summary, and close."""
        try:
            self.flush()
            self._output.write(records.data_end())
            self._output.write(self._end(self._output.position))
            self._output.synchronise()
        finally:
            self._output.close()

    def abandon(self) -> None:
        """Close without further writing, after an error."""
        self._output.close()

    def append(self, rows: list[Pending]) -> None:
        """Append messages of defined channels; each full chunk is written."""
        start = 0
        try:
            for end, row in enumerate(rows, 1):
                self._pending_bytes += len(row[3])
                if self._pending_bytes >= CHUNK_BYTES:
                    self._pending += rows[start:end]
                    start = end
                    self.flush()
        finally:  # after a disk error, `unwritten` has the rest too
            self._pending += rows[start:]

    def _with_attachments(self, messages: Sequence[Message]) -> Iterator[Pending]:
        """Rows with each attachment directly before its message, with the same times, as readers
        expect."""
        for message in messages:
            log_ns, published_ns, topic, key, payload, attachment = message
            if attachment:
                beside = attached_topic(key)
                channel = self._channels.get(beside)
                if channel is None:
                    channel = self._register(beside, topic, ATTACHED)
                yield log_ns, published_ns, channel, attached(attachment)
            yield log_ns, published_ns, self._channels[key], payload

    def _register(self, key: str, topic: Topic, type_name: str = "") -> int:
        """Define a key's channel; `type_name`: if it differs from the topic's."""
        type_name = type_name or topic.type_name
        text = cdr.definition(type_name).encode()
        metadata = {
            "offered_qos_profiles": quality_of_service(topic),
            "topic_type_hash": cdr.type_hash(type_name),
        }
        return self.define(key, type_name, "ros2msg", text, metadata)

    def define(
        self,
        key: str,
        type_name: str,
        schema_encoding: str,
        definition: bytes,
        metadata: Mapping[str, str],
        *,
        encoding: str = "cdr",
    ) -> int:
        """Define a channel of any type, and its schema; return its number. A key may have several
        types."""
        schema = self._schemas.get(type_name)
        if schema is None:
            schema = self._schemas[type_name] = len(self._schemas) + 1
            self._define("schema", records.schema(schema, type_name, schema_encoding, definition))
        self._keys.append(key)
        number = self._channels[key] = len(self._keys)
        self._types.append(type_name)
        self._define("channel", records.channel(number, schema, "/" + key, encoding, metadata))
        return number

    def _define(self, kind: str, definition: bytes) -> None:
        self._definitions[kind].append(definition)
        self._new_definitions.append(definition)

    def _note_channels(self) -> None:
        named = zip(self._keys, self._types, strict=True)
        values = {str(i): json.dumps(["/" + key, name]) for i, (key, name) in enumerate(named, 1)}
        self.note(CHANNELS, values)

    def _remember(self, kind: Opcode, index: bytes) -> None:
        self._summary.setdefault(kind, []).append(index)

    def _end(self, start: int) -> bytes:
        """The summary, the offsets of its groups, the footer."""
        many = {kind: len(self._summary.get(kind, [])) for kind in _INDEXES}
        statistics = records.statistics(
            {number: self._written.get(number, 0) for number in range(1, len(self._keys) + 1)},
            self.times_ns,
            schemas=len(self._schemas),
            attachments=many[Opcode.ATTACHMENT_INDEX],
            metadata_records=many[Opcode.METADATA_INDEX],
            chunks=many[Opcode.CHUNK_INDEX],
        )
        groups: dict[Opcode, list[bytes]] = {
            Opcode.SCHEMA: self._definitions["schema"],
            Opcode.CHANNEL: self._definitions["channel"],
            Opcode.STATISTICS: [statistics],
            **{kind: self._summary.get(kind, []) for kind in _INDEXES},
        }
        summary, offsets = b"", b""
        for kind, group in groups.items():
            if group:
                content = b"".join(group)
                offsets += records.summary_offset(kind, start + len(summary), len(content))
                summary += content
        whole = summary + offsets
        return whole + records.footer(whole, start, start + len(summary)) + records.MAGIC


_INDEXES = (Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX, Opcode.CHUNK_INDEX)
