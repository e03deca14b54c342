"""A recorded session, read: its messages in the order of their log time, and its attachments."""

import logging
from bisect import bisect_left
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import NamedTuple

from trigpoint.errors import RecordingError
from trigpoint.topics import Topic, topic_of

from .mcap_file import ChunkSpan, McapIndex, RawMessage, chunk_messages, read_chunk, read_index

SITE_ATTACHMENT = "site.toml"
NETWORK_ATTACHMENT = "network.json"

_LOG = logging.getLogger(__name__)


class RecordedSample(NamedTuple):
    """One message of a session, its payload as it was on the bus.

    `log_ns`: when the recorder received it; `published_ns`: the sender's Zenoh timestamp. A tuple
    and no dataclass, since it is made a hundred thousand times in a second of reading.
    """

    key: str
    topic: Topic
    payload: bytes
    log_ns: int
    published_ns: int


class Recording:
    """An opened session; holds its index alone, the file is open only while samples are read."""

    def __init__(self, index: McapIndex) -> None:
        self._index = index
        self._topics = _topics_of(index)
        # Offsets of the chunks that were told to be.
        self._damaged: set[int] = set()

    @property
    def path(self) -> Path:
        return self._index.path

    @property
    def problem(self) -> str:
        """Why the file is not complete, in words; "" where it is."""
        return self._index.problem

    @property
    def attachments(self) -> dict[str, bytes]:
        """The attached files by name: site.toml, the target files, network.json."""
        return self._index.attachments

    @property
    def site_text(self) -> str:
        """The attached site.toml; raise RecordingError where there is none."""
        data = self.attachments.get(SITE_ATTACHMENT)
        if data is None:
            raise RecordingError(f"{self.path}: no site.toml is attached; give it with --site")
        return data.decode(errors="replace")

    @property
    def counts(self) -> dict[str, int]:
        """How many messages each key has, in the order in which the keys came."""
        counts: dict[str, int] = {}
        for span in self._index.chunks:
            for channel, count in span.counts.items():
                key = _key(self._index.channels[channel].topic)
                counts[key] = counts.get(key, 0) + count
        return counts

    @property
    def unknown_keys(self) -> list[str]:
        """Keys that the contract does not have; `samples` leaves them out."""
        return [key for key in self.counts if topic_of(key) is None]

    @property
    def start_ns(self) -> int:
        """The first log time."""
        return min(span.start_ns for span in self._index.chunks)

    @property
    def end_ns(self) -> int:
        """The last log time."""
        return max(span.end_ns for span in self._index.chunks)

    def samples(self, topics: Collection[Topic] | None = None) -> Iterator[RecordedSample]:
        """The messages of these topics (None: of all that the contract has) in log-time order.

        Messages of one log time come in the file's order. What lies in a damaged chunk (half a
        second of a session) is left out; the log says so as an error.
        """
        channels = {
            channel: (_key(self._index.channels[channel].topic), topic)
            for channel, topic in self._topics.items()
            if topics is None or topic in topics
        }
        for log_ns, published_ns, channel, payload in self._messages(set(channels)):
            key, topic = channels[channel]
            yield RecordedSample(key, topic, payload, log_ns, published_ns)

    def _messages(self, channels: set[int]) -> Iterator[RawMessage]:
        """Merge the chunks, whose times may overlap: a message waits for the next chunk's start."""
        waiting: list[RawMessage] = []
        wanted = [span for span in self._index.chunks if channels & span.counts.keys()]
        wanted.sort(key=lambda span: (span.start_ns, span.offset))
        with self.path.open("rb") as file:
            for span in wanted:
                ready = bisect_left(waiting, span.start_ns, key=_log_time)
                yield from waiting[:ready]
                waiting = waiting[ready:]
                waiting.extend(chunk_messages(self._read(file, span), channels))
                waiting.sort(key=_log_time)
        yield from waiting

    def _read(self, file, span: ChunkSpan) -> bytes:
        try:
            return read_chunk(file, span)
        except ValueError as reason:
            if span.offset not in self._damaged:
                self._damaged.add(span.offset)
                lost = sum(span.counts.values())
                text = "%s: %s; its %d messages are left out: copy the file again if you can"
                _LOG.error(text, self.path, reason, lost)
            return b""


def open_recording(path: Path) -> Recording:
    """Open an .mcap file, or the one in a folder.

    Raises RecordingError where it is missing, foreign or holds no complete message. A file whose
    recorder was killed is opened as far as it is complete, and a warning says so.
    """
    recording = Recording(read_index(_file(path)))
    file, problem = recording.path, recording.problem
    if not recording.counts:
        why = f"{problem} before its first message was complete" if problem else "has no messages"
        raise RecordingError(f"{file}: the session is empty ({why}); record while the site runs")
    if problem:
        total = sum(recording.counts.values())
        _LOG.warning("%s: not complete: %s; the %d messages before are read", file, problem, total)
    return recording


def _file(path: Path) -> Path:
    if path.is_dir():
        files = sorted(path.glob("*.mcap"))
        if not files:
            raise RecordingError(f"{path}: there is no .mcap file in this folder; check the path")
        if len(files) > 1:
            names = ", ".join(file.name for file in files)
            raise RecordingError(f"{path}: several sessions in this folder ({names}); name one")
        return files[0]
    if not path.exists():
        raise RecordingError(f"{path}: there is no such session; check the path")
    return path


def _topics_of(index: McapIndex) -> dict[int, Topic]:
    """The contract's topic of each channel; raise RecordingError where its type is another."""
    topics = {}
    for channel in index.channels.values():
        topic = topic_of(_key(channel.topic))
        if topic is None:
            continue
        schema = index.schemas.get(channel.schema_id)
        found = schema.name if schema else "no type"
        if found != topic.type_name or channel.message_encoding != "cdr":
            raise RecordingError(
                f"{index.path}: {channel.topic} holds {found} in {channel.message_encoding}, not "
                f"{topic.type_name} in cdr; record it with Trigpoint"
            )
        topics[channel.id] = topic
    return topics


def _key(topic: str) -> str:
    return topic.removeprefix("/")


def _log_time(message: RawMessage) -> int:
    return message.log_ns
