"""Is an MCAP file sound? Every rule of the format's own checker, strict message order included.

Nothing is taken on trust: every record is read, chunks are decompressed, and what is said twice
(indexes, summary, statistics) is held against what it is said of.
"""

import struct
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    Channel,
    Chunk,
    ChunkIndex,
    Footer,
    Header,
    MessageIndex,
    Metadata,
    Schema,
    Statistics,
)
from msgspec import Struct, field

from trigpoint.base.clock import to_seconds
from trigpoint.base.errors import RecordingError
from trigpoint.base.words import counted

from .file import ChunkSpan, fault_of, read_chunk, stream, take_attachment
from .file import McapIndex as _Index
from .index import LONGEST_MAGIC, refuse_others
from .output import is_being_written
from .packed import unpacked
from .records import HEAD, MAGIC, MESSAGE, MESSAGE_FIELDS
from .summary import summary_is_sound

_PROFILES = ("", "ros1", "ros2")
_MOST_TOLD = 1000


class Verdict(Struct):
    """`errors`: what breaks the format; `warnings`: what readers may stumble over; `remarks`: what
    is not as usual, but sound."""

    errors: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    @property
    def is_sound(self) -> bool:
        return not self.errors and not self.warnings


def check(path: Path) -> Verdict:
    """Read the whole file; raise RecordingError where it is no MCAP file at all."""
    try:
        data = unpacked(path).read_bytes()
    except OSError as reason:
        raise RecordingError(f"{path}: cannot be read ({reason.strerror}); check it") from None
    refuse_others(path, data[:LONGEST_MAGIC])
    return _Checker(path, data).run()


class _SeenChunk(Struct):
    offset: int
    length: int
    chunk: Chunk
    indexes: dict[int, MessageIndex] = field(default_factory=dict)
    channels: set[int] = field(default_factory=set)


class _Checker:
    def __init__(self, path: Path, data: bytes) -> None:
        self._path, self._data = path, data
        self._verdict = Verdict()
        self._definitions: dict[type, dict[int, Schema | Channel]] = {Schema: {}, Channel: {}}
        self._in_summary: dict[type, set[int]] = {Schema: set(), Channel: set()}
        self._is_summary = False
        self._chunks: dict[int, _SeenChunk] = {}
        self._last: _SeenChunk | None = None
        self._chunk_indexes: list[ChunkIndex] = []
        self._statistics: list[Statistics] = []
        self._counts: Counter[int] = Counter()
        self._first_ns: int | None = None
        self._last_ns = 0
        self._has_loose_messages = False
        self._is_ours = False
        self._without_index = self._steps_back = 0

    def run(self) -> Verdict:
        is_ended = self._walk()
        self._close_chunk()
        if not is_ended:
            is_running = is_being_written(self._path)
            why = "it is still being written" if is_running else "the recording was broken off"
            self._error(f"there is no footer: {why}")
        elif not self._data.endswith(MAGIC):
            self._error("the file does not end with the format's magic bytes")
        elif not summary_is_sound(self._data):
            self._error("the summary's checksum does not hold")
        self._compare_indexes()
        self._compare_statistics()
        remarks = self._verdict.remarks
        if self._without_index:
            chunks = counted(self._without_index, "chunk")
            remarks.append(f"{chunks} without message index: readers go through all of it")
        if self._steps_back:
            times = counted(self._steps_back, "message")
            remarks.append(f"{times} with an earlier log time than the one before")
        remarks += self._several_types()
        return self._verdict

    def _walk(self) -> bool:
        """Take every record; whether the footer was reached."""
        position, end = len(MAGIC), len(self._data)
        while position + HEAD.size <= end:
            opcode, length = HEAD.unpack_from(self._data, position)
            start = position + HEAD.size
            if start + length > end or not opcode > 0:
                self._error(f"the record at byte {position} is damaged or cut off")
                return False
            if opcode != Opcode.MESSAGE_INDEX:
                self._close_chunk()
            self._take(opcode, position, self._data[start : start + length])
            position = start + length
            if opcode == Opcode.FOOTER:
                return True
        return False

    def _take(self, opcode: int, position: int, body: bytes) -> None:
        take = _TAKEN.get(opcode)
        try:
            if take is not None:
                take(self, position, body)
        except (McapError, ValueError, struct.error, EOFError, IndexError) as reason:
            self._error(f"the record at byte {position} is damaged ({reason})")
        except Exception as reason:  # noqa: BLE001 - whatever the bytes lead the library to
            self._error(f"the record at byte {position} is damaged ({reason!r})")

    def _take_header(self, _position: int, body: bytes) -> None:
        header = Header.read(stream(body))
        if not header.library:
            self._warn("the header does not name the software that wrote the file")
        self._is_ours = header.library.startswith("trigpoint ")
        if header.profile not in _PROFILES:
            self._warn(f"the header's profile «{header.profile}» is not a well-known one")

    def _take_schema(self, _position: int, body: bytes) -> None:
        schema = Schema.read(stream(body))
        if schema.id == 0:
            self._error("a schema has the reserved number 0")
        if not schema.encoding:
            self._warn(f"schema {schema.id} ({schema.name}) has no encoding")
        self._define(Schema, schema.id, schema)

    def _take_channel(self, _position: int, body: bytes) -> None:
        channel = Channel.read(stream(body))
        self._define(Channel, channel.id, channel)
        if channel.schema_id and channel.schema_id not in self._definitions[Schema]:
            self._error(f"channel {channel.id} has the unknown schema {channel.schema_id}")

    def _define(self, kind: type, number: int, definition: Schema | Channel) -> None:
        name, known = kind.__name__.lower(), self._definitions[kind]
        before = known.get(number)
        if before is not None and before != definition:
            self._error(f"two different {name} records have the number {number}")
        if self._is_summary:
            self._in_summary[kind].add(number)
            if before is None:
                self._error(f"{name} {number} of the summary is not in the data")
        else:
            if before is not None:
                self._warn(f"{name} {number} is defined twice in the data")
            known[number] = definition

    def _take_chunk(self, position: int, body: bytes) -> None:
        self._last = _SeenChunk(position, HEAD.size + len(body), Chunk.read(stream(body)))
        self._chunks[position] = self._last

    def _take_message_index(self, position: int, body: bytes) -> None:
        index = MessageIndex.read(stream(body))
        if self._last is None:
            self._error(f"the message index at byte {position} follows no chunk")
        elif index.channel_id in self._last.indexes:
            self._warn(f"channel {index.channel_id} has two indexes of one chunk")
        else:
            self._last.indexes[index.channel_id] = index

    def _take_message(self, position: int, body: bytes) -> None:
        self._has_loose_messages = True
        head = self._data[position : position + MESSAGE.size]
        self._check_structure(*self._take_time(position, head, 0), body[MESSAGE_FIELDS:])

    def _take_chunk_index(self, _position: int, body: bytes) -> None:
        self._chunk_indexes.append(ChunkIndex.read(stream(body)))

    def _take_statistics(self, _position: int, body: bytes) -> None:
        self._statistics.append(Statistics.read(stream(body)))

    def _take_metadata(self, _position: int, body: bytes) -> None:
        Metadata.read(stream(body))

    def _take_attachment(self, position: int, body: bytes) -> None:
        take_attachment(_Index(self._path), body, position)
        Attachment.read(stream(body))

    def _take_footer(self, _position: int, body: bytes) -> None:
        Footer.read(stream(body))

    def _end_data(self, _position: int, _body: bytes) -> None:
        self._is_summary = True

    def _close_chunk(self) -> None:
        """Look into the chunk that has ended, when its indexes are known."""
        seen, self._last = self._last, None
        if seen is None:
            return
        span = ChunkSpan(seen.offset + HEAD.size, seen.length - HEAD.size, 0, 0)
        try:
            with unpacked(self._path).open("rb") as file:
                records = read_chunk(file, span)
        except ValueError as reason:
            self._error(str(reason))
            return
        times = self._look_into(seen, records)
        self._without_index += bool(times) and not seen.indexes
        chunk = seen.chunk
        if times and (min(times), max(times)) != (chunk.message_start_time, chunk.message_end_time):
            self._error(f"the chunk at byte {seen.offset} does not hold the times that it says")

    def _look_into(self, seen: _SeenChunk, records: bytes) -> list[int]:
        entries = {
            channel: {offset: time for time, offset in index.records}
            for channel, index in seen.indexes.items()
        }
        times: list[int] = []
        position = 0
        while position + HEAD.size <= len(records):
            opcode, length = HEAD.unpack_from(records, position)
            body = records[position + HEAD.size : position + HEAD.size + length]
            if opcode == Opcode.MESSAGE:
                channel, log_ns = self._take_time(seen.offset, records, position)
                seen.channels.add(channel)
                times.append(log_ns)
                self._check_structure(channel, log_ns, body[MESSAGE_FIELDS:])
                self._compare_entry(seen, entries, channel, position, log_ns)
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._take(opcode, seen.offset, body)
            else:
                self._error(f"the chunk at byte {seen.offset} holds a record of type {opcode}")
            position += HEAD.size + length
        for channel, left in entries.items():
            if left:
                self._error(
                    f"the chunk at byte {seen.offset} has {len(left)} messages of channel "
                    f"{channel} less than its index names"
                )
        return times

    def _take_time(self, place: int, records: bytes, position: int) -> tuple[int, int]:
        _, _, channel, _, log_ns, _ = MESSAGE.unpack_from(records, position)
        if channel not in self._definitions[Channel]:
            self._error(f"at byte {place}: a message of channel {channel}, which is not defined")
        if log_ns < self._last_ns and not self._is_ours:
            self._steps_back += 1  # rosbag2 writes messages as they come, and opens such files
        elif log_ns < self._last_ns:
            self._error(f"at byte {place}: log time {log_ns} comes after {self._last_ns}")
        self._counts[channel] += 1
        self._first_ns = log_ns if self._first_ns is None else min(self._first_ns, log_ns)
        self._last_ns = max(self._last_ns, log_ns)
        return channel, log_ns

    def _check_structure(self, number: int, log_ns: int, payload: bytes) -> None:
        channel = self._definitions[Channel].get(number)
        if not isinstance(channel, Channel):
            return
        schema = self._definitions[Schema].get(channel.schema_id)
        known = schema if isinstance(schema, Schema) else None
        if fault := fault_of(channel, known, payload):
            self._warn(f"a message of {channel.topic} {fault}, at {to_seconds(log_ns):.3f} s")

    def _compare_entry(
        self,
        seen: _SeenChunk,
        entries: dict[int, dict[int, int]],
        channel: int,
        position: int,
        log_ns: int,
    ) -> None:
        if not seen.indexes:
            return
        if channel not in entries:
            self._warn(f"the chunk at byte {seen.offset} has no index of channel {channel}")
            return
        indexed = entries[channel].pop(position, None)
        if indexed is None:
            self._warn(f"the chunk at byte {seen.offset}: no index names the message at {position}")
        elif indexed != log_ns:
            self._error(f"the chunk at byte {seen.offset}: an index says {indexed}, not {log_ns}")

    def _compare_indexes(self) -> None:
        if self._has_loose_messages and self._chunk_indexes:
            self._warn("there are messages outside of chunks, which readers by the index miss")
        indexed = Counter(index.chunk_start_offset for index in self._chunk_indexes)
        for offset, count in indexed.items():
            if count > 1:
                self._error(f"the chunk at byte {offset} has {count} chunk indexes")
        for offset in self._chunks.keys() - indexed.keys() if indexed else ():
            self._error(f"the chunk at byte {offset} is not in the summary")
        for index in self._chunk_indexes:
            self._compare_index(index)

    def _compare_index(self, index: ChunkIndex) -> None:
        place = f"the summary's entry of the chunk at byte {index.chunk_start_offset}"
        seen = self._chunks.get(index.chunk_start_offset)
        if seen is None:
            self._error(f"{place} points at no chunk")
            return
        chunk = seen.chunk
        said = (
            index.chunk_length,
            index.message_start_time,
            index.message_end_time,
            index.compression,
            index.compressed_size,
            index.uncompressed_size,
        )
        found = (
            seen.length,
            chunk.message_start_time,
            chunk.message_end_time,
            chunk.compression,
            len(chunk.data),
            chunk.uncompressed_size,
        )
        if said != found:
            self._error(f"{place} says {said}, but it has {found}")
        for channel in seen.channels:
            definition = self._definitions[Channel].get(channel)
            if channel not in self._in_summary[Channel]:
                self._error(f"channel {channel} is not repeated in the summary")
            elif isinstance(definition, Channel) and (
                definition.schema_id and definition.schema_id not in self._in_summary[Schema]
            ):
                self._error(f"schema {definition.schema_id} is not repeated in the summary")

    def _compare_statistics(self) -> None:
        if len(self._statistics) > 1:
            self._error("there are several statistics records")
        for said in self._statistics[:1]:
            total = self._counts.total()
            if said.message_count != total:
                self._error(f"the statistics say {said.message_count} messages, it has {total}")
            times = said.message_start_time, said.message_end_time
            if total and times != (self._first_ns, self._last_ns):
                self._error(f"the statistics say {times}, not {(self._first_ns, self._last_ns)}")
            for channel, count in self._counts.items():
                if said.channel_message_counts.get(channel, 0) != count:
                    self._error(f"the statistics miscount channel {channel}, which has {count}")

    def _several_types(self) -> Iterator[str]:
        kinds: dict[str, Counter[str]] = {}
        for number, count in self._counts.items():
            channel = self._definitions[Channel].get(number)
            if isinstance(channel, Channel):
                schema = self._definitions[Schema].get(channel.schema_id)
                name = schema.name if isinstance(schema, Schema) else "no type"
                kinds.setdefault(channel.topic, Counter())[name] += count
        for topic, counts in kinds.items():
            if len(counts) > 1:
                each = ", ".join(f"{count} of {name}" for name, count in counts.items())
                yield f"{topic} has messages of several types: {each}"

    def _error(self, text: str) -> None:
        if len(self._verdict.errors) < _MOST_TOLD:
            self._verdict.errors.append(text)

    def _warn(self, text: str) -> None:
        if len(self._verdict.warnings) < _MOST_TOLD:
            self._verdict.warnings.append(text)


_TAKEN: dict[int, Callable[[_Checker, int, bytes], None]] = {
    Opcode.HEADER: _Checker._take_header,
    Opcode.FOOTER: _Checker._take_footer,
    Opcode.SCHEMA: _Checker._take_schema,
    Opcode.CHANNEL: _Checker._take_channel,
    Opcode.MESSAGE: _Checker._take_message,
    Opcode.CHUNK: _Checker._take_chunk,
    Opcode.MESSAGE_INDEX: _Checker._take_message_index,
    Opcode.CHUNK_INDEX: _Checker._take_chunk_index,
    Opcode.ATTACHMENT: _Checker._take_attachment,
    Opcode.STATISTICS: _Checker._take_statistics,
    Opcode.METADATA: _Checker._take_metadata,
    Opcode.DATA_END: _Checker._end_data,
}
