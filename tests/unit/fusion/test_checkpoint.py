"""What came in is on the disk: whole, cut off, foreign."""

import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from random import Random

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.builders import largest_file

from trigpoint.base.clock import ManualClock
from trigpoint.base.errors import OperationError
from trigpoint.contract.cdr import encode
from trigpoint.contract.messages import Odometry
from trigpoint.fusion.checkpoint import Checkpoint, read_checkpoint
from trigpoint.geometry import Pose

RECORDS = [(f"lab/robot/r1/odom{i}", Random(i).randbytes(10 * i)) for i in range(8)]


def write(path: Path, records: list[tuple[str, bytes]]) -> None:
    """Each a second after the one before, and so a record of its own."""
    clock = ManualClock()
    checkpoint = Checkpoint(path, clock)
    for key, payload in records:
        checkpoint.write(key, payload)
        clock.advance(1.0)
        checkpoint.flush()
    checkpoint.close()


@given(
    records=st.lists(st.tuples(st.text(max_size=20), st.binary(max_size=200)), max_size=10),
    parts=st.integers(0, 10),
)
def test_what_is_written_is_read_again_also_over_several_lives(
    tmp_path_factory: pytest.TempPathFactory, records: list[tuple[str, bytes]], parts: int
) -> None:
    path = tmp_path_factory.mktemp("checkpoint") / "checkpoint.bin"
    write(path, records[:parts])
    write(path, records[parts:])
    assert list(read_checkpoint(path)) == records


def test_odometry_of_half_a_second_takes_a_tenth_of_its_length(tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.bin"
    messages = [
        encode(
            Odometry(20_000_000 * number, "r1/odom", "r1/base", Pose.planar(x, 0.3 * x, 0.1 * x))
        )
        for number, x in enumerate(Random(1).random() for _ in range(500))
    ]
    clock = ManualClock()
    checkpoint = Checkpoint(path, clock)
    for message in messages:
        checkpoint.write("lab/robot/r1/odom", message)
        clock.advance(0.02)
        checkpoint.flush()
    checkpoint.close()
    assert [payload for _, payload in read_checkpoint(path)] == messages
    assert path.stat().st_size < sum(map(len, messages)) / 10


@pytest.mark.parametrize("packed", [bytes, zlib.compress])
def test_file_of_before_messages_were_compressed_together_is_read_and_goes_on(
    tmp_path: Path, packed: Callable[[bytes], bytes]
) -> None:
    path = tmp_path / "checkpoint.bin"
    key, payload = (
        "lab/robot/r1/odom",
        encode(Odometry(1, "r1/odom", "r1/base", Pose.identity())),
    )
    body = msgspec.msgpack.encode((key, packed(payload)))
    record = struct.pack("<II", len(body), zlib.crc32(body)) + body
    path.write_bytes(b"trigpoint-checkpoint/1\n" + b"damaged" + 2 * record)
    write(path, RECORDS)
    assert list(read_checkpoint(path)) == [(key, payload), (key, payload), *RECORDS]


def test_no_file_holds_nothing(tmp_path: Path) -> None:
    assert list(read_checkpoint(tmp_path / "none.bin")) == []


@pytest.mark.parametrize("cut", [1, 3, 50])
def test_record_that_was_cut_off_is_passed_over_and_kept(
    tmp_path: Path, cut: int, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "checkpoint.bin"
    write(path, RECORDS)
    before = path.read_bytes()[:-cut]
    path.write_bytes(before)
    assert list(read_checkpoint(path)) == RECORDS[:-1]
    assert "cut off" in caplog.text
    write(path, [("after", b"1")])
    assert list(read_checkpoint(path)) == [*RECORDS[:-1], ("after", b"1")]
    assert path.read_bytes().startswith(before)


@given(place=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7))
def test_flipped_bit_costs_one_record_and_nothing_is_written_over(
    tmp_path_factory: pytest.TempPathFactory, place: float, bit: int
) -> None:
    path = tmp_path_factory.mktemp("checkpoint") / "checkpoint.bin"
    write(path, RECORDS)
    data = bytearray(path.read_bytes())
    data[int(place * len(data))] ^= 1 << bit
    path.write_bytes(bytes(data))
    found = list(read_checkpoint(path))
    assert len(found) >= len(RECORDS) - 1
    assert [record for record in RECORDS if record in found] == found
    write(path, [("after", b"1")])
    assert list(read_checkpoint(path)) == [*found, ("after", b"1")]
    assert path.read_bytes().startswith(bytes(data))


def test_damaged_stretch_in_the_middle_is_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.bin"
    write(path, RECORDS)
    data = bytearray(path.read_bytes())
    middle = len(data) // 2
    data[middle - 20 : middle + 20] = bytes(40)
    path.write_bytes(bytes(data))
    found = list(read_checkpoint(path))
    assert found[0] == RECORDS[0]
    assert found[-1] == RECORDS[-1]
    assert len(RECORDS) - 3 <= len(found) < len(RECORDS)


def test_foreign_file_is_named_and_kept(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path, content = tmp_path / "checkpoint.bin", b"PK\x03\x04 something else entirely"
    path.write_bytes(content)
    assert list(read_checkpoint(path)) == []
    write(path, RECORDS)
    assert "is not a checkpoint; it is kept as" in caplog.text
    assert (tmp_path / "checkpoint.1.bin").read_bytes() == content
    assert list(read_checkpoint(path)) == RECORDS


def test_record_is_on_the_disk_half_a_second_later(tmp_path: Path) -> None:
    path, clock = tmp_path / "checkpoint.bin", ManualClock()
    checkpoint = Checkpoint(path, clock)
    checkpoint.write("key", b"payload")
    checkpoint.flush()
    assert list(read_checkpoint(path)) == []
    clock.advance(0.6)
    checkpoint.flush()
    assert list(read_checkpoint(path)) == [("key", b"payload")]
    checkpoint.close()


def test_restart_begins_anew_and_keeps_what_was(tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.bin"
    checkpoint = Checkpoint(path, ManualClock())
    checkpoint.write("old", b"1")
    checkpoint.restart()
    checkpoint.write("new", b"2")
    checkpoint.close()
    assert list(read_checkpoint(path)) == [("new", b"2")]
    assert list(read_checkpoint(tmp_path / "checkpoint.1.bin")) == [("old", b"1")]


def test_disk_that_is_full_keeps_what_was_written_and_is_told(tmp_path: Path) -> None:
    path, clock = tmp_path / "checkpoint.bin", ManualClock()
    checkpoint = Checkpoint(path, clock)
    with largest_file(1000):
        kept = 0
        while checkpoint.write(f"lab/robot/r1/odom{kept}", bytes(200)):
            kept += 1
            clock.advance(1.0)
            checkpoint.flush()
        assert "cannot be written now (File too large)" in checkpoint.trouble
        found = list(read_checkpoint(path))
    assert [key for key, _ in found] == [f"lab/robot/r1/odom{i}" for i in range(len(found))]
    assert 3 <= len(found) < kept + 1
    checkpoint.write("after", b"1")  # there is room again, behind half a record
    checkpoint.close()
    assert checkpoint.trouble == ""
    waited = (f"lab/robot/r1/odom{kept}", bytes(200))
    assert list(read_checkpoint(path)) == [*found, waited, ("after", b"1")]


def test_restart_after_the_disk_was_full_writes_again(tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.bin"
    checkpoint = Checkpoint(path, ManualClock())
    with largest_file(1000):
        while checkpoint.write("old", bytes(2000)):
            pass
    checkpoint.restart()
    assert checkpoint.write("new", b"2")
    checkpoint.close()
    assert checkpoint.trouble == ""
    assert list(read_checkpoint(path)) == [("new", b"2")]


def test_place_that_cannot_be_used_is_one_clear_line(tmp_path: Path) -> None:
    folder, file = tmp_path / "folder", tmp_path / "file"
    folder.mkdir()
    file.write_text("taken")
    for path in (folder, file / "checkpoint.bin"):
        with pytest.raises(OperationError, match="give another --out"):
            Checkpoint(path, ManualClock())
    with pytest.raises(OperationError, match="cannot be read"):
        list(read_checkpoint(folder))
