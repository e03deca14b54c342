"""Sessions written and read: our sink and our reader against those of the mcap library, and
pictures of a mebibyte against a plain file that is synchronised."""

import os
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from trigpoint.base.clock import SystemClock
from trigpoint.contract import cdr, topics
from trigpoint.contract.topics import Topic
from trigpoint.recorder.session.recording import open_recording
from trigpoint.recorder.writing.sink import McapSink

from .network.messages import odometry, picture
from .table import Row, share_of
from .timing import timed

_PICTURES, _READINGS, _LARGE = 500, 60_000, 60  # each fits into the sink's queue of 64 MiB
_ROUNDS = 3
_PLAIN_ROUNDS = 9  # a twentieth of a second each, which anything else on the machine disturbs


@dataclass(frozen=True, slots=True)
class Load:
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
    large = Load("pictures, 1 MiB", topics.IMAGE, os.urandom(2**20), share_of(_LARGE, effort))
    return [row for load in loads for row in _rows(load)] + [_plain_row(large)]


def _plain_row(load: Load) -> Row:
    """The best of some rounds of writing, in turns with the plain file."""
    ours, plain = [], []
    for _ in range(_PLAIN_ROUNDS):
        with TemporaryDirectory() as folder:
            path = Path(folder) / "ours.mcap"
            ours.append(timed(lambda path=path: _write(load, path))[0])
            file = Path(folder) / "plain.bin"
            plain.append(timed(lambda file=file: _write_plain(load, file))[0])
    mine, theirs = load.megabytes / min(ours), load.megabytes / min(plain)
    other = "a plain file, then fsync"
    return Row("recorder", f"write {load.what}", "MB/s", mine, theirs, other, more_is_better=True)


def _write_plain(load: Load, path: Path) -> None:
    with path.open("wb", buffering=0) as file:
        for _ in range(load.count):
            file.write(load.payload)
        os.fsync(file.fileno())


def _rows(load: Load) -> list[Row]:
    """The best of some rounds, in which all four jobs take turns."""
    rounds = [_round(load) for _ in range(_ROUNDS)]
    ours, bare, our_reader, bare_reader = (
        load.megabytes / min(s) for s in zip(*rounds, strict=True)
    )
    writer = "mcap's writer, then fsync"
    return [
        Row("recorder", f"write {load.what}", "MB/s", ours, bare, writer, more_is_better=True),
        Row(
            "recorder",
            f"read {load.what}",
            "MB/s",
            our_reader,
            bare_reader,
            "mcap's reader",
            more_is_better=True,
        ),
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
