"""Reads a recorded session: its messages in log-time order, and its attachments."""

import logging
from bisect import bisect_left
from collections.abc import Collection, Iterator, Sequence
from operator import attrgetter
from pathlib import Path
from typing import IO

from msgspec import Struct

from trigpoint.base.errors import RecordingError
from trigpoint.contract.topics import Topic, topic_of
from trigpoint.recorder.mcap.channels import attached_to, attachment_in
from trigpoint.recorder.mcap.file import (
    ChunkSpan,
    McapIndex,
    RawMessage,
    chunk_messages,
    is_of_ros2,
    read_chunk,
)
from trigpoint.recorder.mcap.index import read_index
from trigpoint.recorder.mcap.packed import unpacked

from .files import repeated_keys, session_files

SITE_ATTACHMENT = "site.toml"
NETWORK_ATTACHMENT = "network.json"
LAST_NS = 2**63 - 1

_LOG = logging.getLogger(__name__)


class RecordedSample(Struct, frozen=True):
    """One message of a session, its payload as it was on the bus.

    `log_ns`: when the recorder received it; `published_ns`: the sender's Zenoh timestamp.
    """

    key: str
    topic: Topic
    payload: bytes
    log_ns: int
    published_ns: int
    attachment: bytes = b""


class Recording:
    """An opened session, of one file or of several parts in recording order.

    It holds only their indexes; files are open only while samples are read.
    """

    def __init__(self, indexes: Sequence[McapIndex]) -> None:
        self.parts = tuple(indexes)
        # Damaged chunks that were already reported.
        self._damaged: set[tuple[Path, int]] = set()

    @property
    def path(self) -> Path:
        """The file, or the first of several; of a bag that is no MCAP its folder."""
        return self.parts[0].path

    @property
    def folder(self) -> Path:
        """Where what belongs to it lies: a site file, a network."""
        return self.path if self.path.is_dir() else self.path.parent

    @property
    def name(self) -> str:
        """The file's name without a suffix."""
        return unpacked(self.path).stem

    @property
    def problem(self) -> str:
        """What is damaged or missing, in words; "" if nothing is."""
        if len(self.parts) == 1:
            return self.parts[0].problem
        return "; ".join(f"{p.path.name}: {p.problem}" for p in self.parts if p.problem)

    @property
    def attachments(self) -> dict[str, bytes]:
        """The attached files by name: site.toml, the target files, network.json."""
        return {name: data for part in self.parts for name, data in part.attachments.items()}

    @property
    def notes(self) -> dict[str, dict[str, str]]:
        """Metadata by name, from the last part."""
        return {name: values for part in self.parts for name, values in part.metadata.items()}

    @property
    def site_text(self) -> str:
        """The attached site.toml; raise RecordingError if there is none."""
        data = self.attachments.get(SITE_ATTACHMENT)
        if data is None:
            beside = self.folder / SITE_ATTACHMENT
            give = f"give it with --site {beside}" if beside.exists() else "give it with --site"
            raise RecordingError(f"{self.path}: no site.toml is attached; {give}")
        return data.decode(errors="replace")

    @property
    def counts(self) -> dict[str, int]:
        """Number of messages by key, in order of first appearance; includes messages that a later
        part repeats from an earlier one."""
        counts: dict[str, int] = {}
        for part in self.parts:
            for span in part.chunks:
                for channel, count in span.counts.items():
                    key = key_of(part, channel)
                    if not attached_to(key):
                        counts[key] = counts.get(key, 0) + count
        return counts

    @property
    def unknown_keys(self) -> list[str]:
        """Keys that are not in the contract; `samples` leaves them out."""
        return [key for key in self.counts if topic_of(key) is None]

    def check_is_session(self) -> None:
        """Raise RecordingError where none of its keys is in the contract, or one has another type:
        it is anybody's bag."""
        for index in self.parts:
            check_types(index)
        if len(self.unknown_keys) == len(self.counts):
            kinds = {key_of(p, each): p.type_of(each) for p in self.parts for each in p.channels}
            is_ours = {key: is_of_ros2(kind) for key, kind in kinds.items()}
            topics = ", ".join(
                f"/{key}{'' if is_ours[key] else f' ({kinds[key]})'}" for key in self.counts
            )
            ways = {
                True: "detect, intrinsics and calibrate take them by --topic",
                False: "convert it to ROS 2's CDR, then detect, intrinsics and calibrate take them",
            }
            raise RecordingError(
                f"{self.path}: none of its topics ({topics}) is one of a session of Trigpoint; "
                f"{ways[any(is_ours.values())]}"
            )

    @property
    def start_ns(self) -> int:
        """The first log time."""
        return min(span.start_ns for part in self.parts for span in part.chunks)

    @property
    def end_ns(self) -> int:
        """The last log time."""
        return max(span.end_ns for part in self.parts for span in part.chunks)

    def samples(
        self, topics: Collection[Topic] | None = None, *, from_ns: int = 0, to_ns: int = LAST_NS
    ) -> Iterator[RecordedSample]:
        """The messages of these topics (None: all of the contract's) in log-time order, from one
        log time to another, both included.

        Messages with equal log times come in file order. The contents of a damaged chunk (half a
        second of a session) are left out, which is logged as an error. Raises RecordingError where
        a key of the contract has another type.
        """
        for number, part in enumerate(self.parts):
            check_types(part)
            wanted: dict[int, tuple[str, Topic]] = {}
            attached: dict[int, str] = {}
            for channel in part.channels:
                key = key_of(part, channel)
                topic = topic_of(attached_to(key) or key)
                if topic is None or (topics is not None and topic not in topics):
                    continue
                if owner := attached_to(key):
                    attached[channel] = owner
                else:
                    wanted[channel] = key, topic
            repeated = repeated_keys(part) if number else set()
            messages = self.messages(part, {*wanted, *attached}, from_ns, to_ns)
            yield from _joined(messages, wanted, attached, repeated)

    def messages(
        self, part: McapIndex, channels: set[int], from_ns: int = 0, to_ns: int = LAST_NS
    ) -> Iterator[RawMessage]:
        """A part's messages on these channels. Chunks may overlap in time, so they are merged: a
        message waits for the next chunk's start."""
        waiting: list[RawMessage] = []
        wanted = [
            span
            for span in part.chunks
            if channels & span.counts.keys() and span.end_ns >= from_ns and span.start_ns <= to_ns
        ]
        wanted.sort(key=lambda span: (span.start_ns, span.offset))
        with unpacked(part.path).open("rb") as file:
            for span in wanted:
                ready = bisect_left(waiting, span.start_ns, key=attrgetter("log_ns"))
                yield from _between(waiting[:ready], from_ns, to_ns)
                waiting = waiting[ready:]
                waiting.extend(chunk_messages(self._read(part, file, span), channels))
                waiting.sort(key=attrgetter("log_ns"))
        yield from _between(waiting, from_ns, to_ns)

    def _read(self, part: McapIndex, file: IO[bytes], span: ChunkSpan) -> bytes:
        try:
            return read_chunk(file, span)
        except ValueError as reason:
            if (part.path, span.offset) not in self._damaged:
                self._damaged.add((part.path, span.offset))
                lost = sum(span.counts.values())
                text = "%s: %s; its %d messages are left out: copy the file again if you can"
                _LOG.error(text, part.path, reason, lost)
            return b""


def _joined(
    messages: Iterator[RawMessage],
    wanted: dict[int, tuple[str, Topic]],
    attached: dict[int, str],
    repeated: set[str],
) -> Iterator[RecordedSample]:
    """Messages with their attachments, which directly precede them with the same times."""
    held: dict[str, RawMessage] = {}
    for message in messages:
        log_ns, published_ns, channel, payload, _ = message
        if channel in attached:
            held[attached[channel]] = message
            continue
        key, topic = wanted[channel]
        beside = held.pop(key, None) if held else None
        if key in repeated:
            repeated.discard(key)
            continue
        if beside is not None and (beside.log_ns, beside.published_ns) == (log_ns, published_ns):
            attachment = attachment_in(beside.payload)
            yield RecordedSample(key, topic, payload, log_ns, published_ns, attachment)
        else:
            yield RecordedSample(key, topic, payload, log_ns, published_ns)


def _between(messages: list[RawMessage], from_ns: int, to_ns: int) -> list[RawMessage]:
    if from_ns == 0 and to_ns == LAST_NS:
        return messages
    return [message for message in messages if from_ns <= message.log_ns <= to_ns]


def key_of(part: McapIndex, channel: int) -> str:
    """The key of a channel."""
    return part.channels[channel].topic.removeprefix("/")


def open_recording(path: Path) -> Recording:
    """Open an .mcap file, or the one in a folder.

    Raises RecordingError if it is missing, foreign or has no complete message. A file whose
    recorder was killed is opened as far as it is complete, with a warning.
    """
    recording = Recording([read_index(file) for file in session_files(path)])
    file, problem = recording.path, recording.problem
    if not recording.counts:
        if problem:
            why, remedy = (
                f"{problem} before its first message was complete",
                "copy or record it anew",
            )
        else:
            why, remedy = "has no messages", "record while the site runs"
        raise RecordingError(f"{file}: the session is empty ({why}); {remedy}")
    if problem:
        total = sum(recording.counts.values())
        _LOG.warning(
            "%s: not whole: %s; its %d sound messages are read (`trigpoint recover` makes a "
            "whole file of them)",
            file,
            problem,
            total,
        )
    return recording


def check_types(index: McapIndex) -> None:
    """Raise RecordingError if a key of the contract has a type other than the contract's."""
    for channel in index.channels.values():
        topic = topic_of(channel.topic.removeprefix("/"))
        if topic is None:
            continue
        schema = index.schemas.get(channel.schema_id)
        found = schema.name if schema else "no type"
        if found != topic.type_name or channel.message_encoding != "cdr":
            raise RecordingError(
                f"{index.path}: {channel.topic} holds {found} in {channel.message_encoding}, not "
                f"{topic.type_name} in cdr; record it with Trigpoint, or give the topics of "
                "another bag to detect, intrinsics or calibrate by --topic"
            )
