"""Writes an MCAP file by the contract: profile ros2, CDR, full definitions, checksums."""

import os
from pathlib import Path

from mcap.writer import CompressionType, Writer

from trigpoint import __version__, cdr
from trigpoint.errors import OperationError
from trigpoint.topics import Delivery, Topic

_INFINITE = "{sec: 9223372036, nsec: 854775807}"


class McapWriter:
    """An MCAP file being written, by one thread.

    Every method raises OperationError where the disk does not take the bytes; the file then stays
    readable as far as its last complete chunk.
    """

    def __init__(self, path: Path) -> None:
        """Create the file and its folder; raise OperationError where it is there already."""
        self.path = path
        self.counts: dict[str, int] = {}
        self._output = _Output(path)
        # The writer only calls `write`, `tell` and `flush`, which _Output has.
        self._writer = Writer(self._output, compression=CompressionType.ZSTD)  # pyright: ignore[reportArgumentType]
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._writer.start(profile="ros2", library=f"trigpoint {__version__}")

    def add(
        self, topic: Topic, key: str, payload: bytes, *, log_ns: int, published_ns: int
    ) -> None:
        """Append one message; its chunk is written when it is full or on `flush`."""
        channel = self._channels.get(key)
        if channel is None:
            channel = self._channels[key] = self._register(topic, key)
        sequence = self.counts.get(key, 0)
        self._writer.add_message(channel, log_ns, payload, published_ns, sequence & 0xFFFFFFFF)
        self.counts[key] = sequence + 1

    def attach(self, name: str, data: bytes, media_type: str, *, time_ns: int) -> None:
        """Append a file."""
        self._writer.add_attachment(time_ns, time_ns, name, media_type, data)

    def flush(self) -> None:
        """Close the chunk and hand it to the operating system: a kill does not lose it."""
        self._writer.flush()

    def synchronise(self) -> None:
        """Wait until the disk has what was flushed: a power cut does not lose it."""
        self._output.synchronise()

    def finish(self) -> None:
        """Write the rest and the summary, and close."""
        try:
            self._writer.finish()
            self._output.synchronise()
        finally:
            self._output.close()

    def abandon(self) -> None:
        """Close without writing any more, after an error."""
        self._output.close()

    def _register(self, topic: Topic, key: str) -> int:
        schema = self._schemas.get(topic.type_name)
        if schema is None:
            definition = cdr.definition(topic.type_name).encode()
            schema = self._writer.register_schema(topic.type_name, "ros2msg", definition)
            self._schemas[topic.type_name] = schema
        metadata = {
            "offered_qos_profiles": quality_of_service(topic),
            "topic_type_hash": cdr.type_hash(topic.type_name),
        }
        return self._writer.register_channel("/" + key, "cdr", schema, metadata)


def quality_of_service(topic: Topic) -> str:
    """The topic's delivery as rosbag2's YAML (Jazzy writes the policies as words)."""
    keeps = topic.delivery is Delivery.LAST_VALUE
    return (
        "- history: keep_last\n"
        f"  depth: {max(1, topic.cache)}\n"
        f"  reliability: {'reliable' if topic.delivery.is_reliable else 'best_effort'}\n"
        f"  durability: {'transient_local' if keeps else 'volatile'}\n"
        f"  deadline: {_INFINITE}\n"
        f"  lifespan: {_INFINITE}\n"
        "  liveliness: automatic\n"
        f"  liveliness_lease_duration: {_INFINITE}\n"
        "  avoid_ros_namespace_conventions: false\n"
    )


class _Output:
    """The file without a buffer of Python's: what is written is with the operating system."""

    def __init__(self, path: Path) -> None:
        self._path = path
        if path.exists():
            raise OperationError(f"{path}: is there already; give another folder")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("xb", buffering=0)
        except OSError as reason:
            raise OperationError(
                f"{path}: cannot be created ({reason.strerror}); give another folder with --out"
            ) from None
        self._position = 0

    def write(self, data: bytes) -> int:
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError as reason:
            raise OperationError(
                f"{self._path}: writing failed ({reason.strerror}) after "
                f"{self._position / 1e6:.1f} MB, which are kept; make room on the disk"
            ) from None
        self._position += len(data)
        return len(data)

    def tell(self) -> int:
        return self._position

    def flush(self) -> None:
        """Nothing waits here."""

    def synchronise(self) -> None:
        try:
            os.fsync(self._file.fileno())
        except OSError as reason:
            raise OperationError(
                f"{self._path}: the disk refuses to synchronise ({reason.strerror}); check it"
            ) from None

    def close(self) -> None:
        self._file.close()
