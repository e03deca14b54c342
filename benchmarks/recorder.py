"""Sessions written and read: our sink and our reader against those of the mcap library."""

import os
from pathlib import Path
from tempfile import TemporaryDirectory

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from msgspec import Struct

from trigpoint.base.clock import SystemClock
from trigpoint.contract import cdr, topics
from trigpoint.contract.topics import Topic
from trigpoint.recorder.session.recording import open_recording
from trigpoint.recorder.writing.sink import McapSink

from .network.messages import odometry, picture
from .table import Row, share_of
from .timing import timed

_PICTURES, _READINGS = 500, 60_000  # each fits into the sink's queue of 64 MiB
_ROUNDS = 3


class Load(Struct, frozen=True):
    """One payload `count` times on a topic."""

    what: str
    topic: Topic
    payload: bytes
    count: int

    @property
    def megabytes(self) -> float:
        return len(self.payload) * self.count / 1e6


def run(effort: float = 1.0) -> list[Row]:
    """Write and read pictures, which are large, and odometry, which is small; MB/s."""
    image, reading = cdr.encode(picture()), cdr.encode(odometry())
    loads = (
        Load("pictures, 100 kB", topics.IMAGE, image, share_of(_PICTURES, effort)),
        Load("odometry, 720 B", topics.ODOMETRY, reading, share_of(_READINGS, effort)),
        Load("messages, 100 B", topics.ODOMETRY, bytes(100), share_of(_READINGS, effort)),
    )
    return [row for load in loads for row in _rows(load)]


def _rows(load: Load) -> list[Row]:
    """The best of some rounds, in which all four jobs take turns."""
    rounds = [_round(load) for _ in range(_ROUNDS)]
    ours, bare, our_reader, bare_reader = (
        load.megabytes / min(s) for s in zip(*rounds, strict=True)
    )

    def row(what: str, ours: float, other: float, against: str) -> Row:
        what = f"{what} {load.what}"
        return Row("recorder", what, "MB/s", ours, other, against, more_is_better=True)

    return [
        row("write", ours, bare, "mcap's writer, then fsync"),
        row("read", our_reader, bare_reader, "mcap's reader"),
    ]


def _round(load: Load) -> tuple[float, float, float, float]:
    """Seconds to write with ours and the bare writer, and to read with ours and the bare reader."""
    with TemporaryDirectory() as folder:
        ours, bare = Path(folder) / "ours.mcap", Path(folder) / "bare.mcap"
        writing = timed(lambda: _write(load, ours))[0], timed(lambda: _write_bare(load, bare))[0]
        our_seconds, our_count = timed(lambda: _read(ours))
        bare_seconds, bare_count = timed(lambda: _read_bare(ours))
    if not our_count == bare_count == load.count:
        raise AssertionError(f"{load.what}: read {our_count} and {bare_count} of {load.count}")
    return *writing, our_seconds, bare_seconds


def _write(load: Load, path: Path) -> None:
    """All at once: what the disk has not taken yet waits in the sink."""
    key = load.topic.key("lab", "c1")
    with McapSink(path, clock=SystemClock()) as sink:
        for i in range(load.count):
            sink.write(load.topic, key, load.payload, log_ns=i, published_ns=i)
    if sink.lost:
        raise AssertionError(f"{load.what}: the sink lost {sink.lost} of {load.count}")


def _write_bare(load: Load, path: Path) -> None:
    name = load.topic.type_name
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(profile="ros2")
        schema = writer.register_schema(name, "ros2msg", cdr.definition(name).encode())
        channel = writer.register_channel("/" + load.topic.key("lab", "c1"), "cdr", schema)
        for i in range(load.count):
            writer.add_message(channel, i, load.payload, i, i)
        writer.finish()
        file.flush()
        os.fsync(file.fileno())


def _read(path: Path) -> int:
    return sum(1 for _ in open_recording(path).samples())


def _read_bare(path: Path) -> int:
    with path.open("rb") as file:
        return sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages())
