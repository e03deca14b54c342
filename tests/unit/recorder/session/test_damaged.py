"""Damage anywhere in a file costs what it hits, is named, and never ends in a crash."""

import logging
import os
from pathlib import Path

import pytest
from support.builders import make_odometry

from trigpoint.base.errors import RecordingError
from trigpoint.contract import cdr
from trigpoint.contract.topics import ODOMETRY
from trigpoint.recorder.mcap.check import check
from trigpoint.recorder.mcap.index import read_index
from trigpoint.recorder.mcap.writer import McapWriter
from trigpoint.recorder.session.info import info_lines, session_info
from trigpoint.recorder.session.recording import open_recording
from trigpoint.recorder.session.recover import recover

KEY = ODOMETRY.key("lab", "r1")
CHUNKS = 4
STRIDE = int(os.environ.get("TRIGPOINT_STRIDE", "7"))
"""Every byte is tried where this is 1, which takes a minute."""


def write(path: Path, *, finished: bool = True) -> Path:
    """Four chunks of two messages; log times 0 … 7."""
    writer = McapWriter(path)
    writer.attach("site.toml", b'site = "lab"', "application/toml", time_ns=0)
    for log_ns in range(2 * CHUNKS):
        payload = cdr.encode(make_odometry(log_ns))
        writer.add(ODOMETRY, KEY, payload, log_ns=log_ns, published_ns=log_ns)
        if log_ns % 2:
            writer.flush()
    if finished:
        writer.finish()
    else:
        writer.abandon()
    return path


def read(path: Path) -> list[int]:
    try:
        return [sample.log_ns for sample in open_recording(path).samples()]
    except RecordingError:
        return []


@pytest.mark.parametrize("finished", [True, False])
def test_any_byte_flipped_costs_at_most_its_own_chunk(
    tmp_path: Path, finished: bool, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.CRITICAL)
    whole = write(tmp_path / "whole.mcap", finished=finished)
    spans = read_index(whole).chunks
    data = whole.read_bytes()
    damaged = tmp_path / "damaged.mcap"
    everything = set(range(2 * CHUNKS))
    for position in range(8, len(data), STRIDE):
        damaged.write_bytes(data[:position] + bytes([data[position] ^ 0xFF]) + data[position + 1 :])
        hit = {
            2 * i + k
            for i, span in enumerate(spans)
            if span.offset - 9 <= position < span.offset + span.length
            for k in (0, 1)
        }
        times = read(damaged)
        assert times == sorted(times), position
        assert set(times) >= everything - hit, position
        assert len(times) == len(set(times)), position


def test_any_cut_leaves_every_complete_chunk(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.CRITICAL)
    whole = write(tmp_path / "whole.mcap")
    spans = read_index(whole).chunks
    data = whole.read_bytes()
    cut = tmp_path / "cut.mcap"
    for length in range(0, len(data), STRIDE):
        cut.write_bytes(data[:length])
        complete = sum(span.offset + span.length <= length for span in spans)
        assert read(cut) == list(range(2 * complete)), length


def test_the_index_is_used_where_a_records_head_is_damaged(tmp_path: Path) -> None:
    path = write(tmp_path / "s.mcap")
    data = bytearray(path.read_bytes())
    data[read_index(path).chunks[0].offset - 8] ^= 0x40  # the first chunk's length
    path.write_bytes(data)
    assert read(path) == list(range(2 * CHUNKS))


def test_what_is_damaged_is_named(tmp_path: Path) -> None:
    path = write(tmp_path / "s.mcap", finished=False)
    data = bytearray(path.read_bytes())
    second = read_index(path).chunks[1]
    data[second.offset - 9] = 0xEE
    path.write_bytes(data)
    problem = read_index(path).problem
    assert f"bytes {second.offset - 9} to" in problem
    assert read(path) == [0, 1, 4, 5, 6, 7]


def test_a_file_with_its_end_is_said_to_be_damaged_not_to_lack_something(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = write(tmp_path / "s.mcap")
    data = bytearray(path.read_bytes())
    data[-10] ^= 0xFF  # the summary's checksum
    path.write_bytes(data)
    lines = info_lines(session_info(open_recording(path)))
    assert read(path) == list(range(2 * CHUNKS))
    assert "not whole: its summary at the end is damaged" in lines
    assert "complete" not in "".join([*lines, caplog.text])


def test_a_recovered_file_is_sound_and_has_all_that_was(tmp_path: Path) -> None:
    path = write(tmp_path / "s.mcap", finished=False)
    assert not check(path).is_sound
    saved = tmp_path / "out" / "s.mcap"
    assert recover(open_recording(path), saved) == {KEY: 2 * CHUNKS}
    assert check(saved).is_sound
    recording = open_recording(saved)
    assert recording.problem == ""
    assert recording.attachments == {"site.toml": b'site = "lab"'}
    assert len(recording.parts[0].chunks) == 1
    before, after = open_recording(path).samples(), recording.samples()
    assert list(after) == list(before)


def test_a_session_is_sound_by_every_rule(session_file: Path) -> None:
    verdict = check(session_file)
    assert verdict.errors == []
    assert verdict.warnings == []


@pytest.mark.parametrize(
    ("name", "complaint"),
    [("chunk", "is damaged"), ("index", "index"), ("summary", "checksum"), ("end", "footer")],
)
def test_the_check_finds_damage(tmp_path: Path, name: str, complaint: str) -> None:
    path = write(tmp_path / "s.mcap")
    data = bytearray(path.read_bytes())
    span = read_index(path).chunks[1]
    if name == "chunk":
        data[span.offset + span.length - 3] ^= 0xFF
    elif name == "index":
        data[span.offset + span.length + 9 + 6] ^= 0xFF  # a time in the first message index
    elif name == "summary":
        data[-38] ^= 0xFF
    else:
        del data[-40:]
    path.write_bytes(data)
    assert any(complaint in text for text in check(path).errors)


def test_the_check_finds_times_out_of_order(tmp_path: Path) -> None:
    writer = McapWriter(tmp_path / "s.mcap")
    for log_ns in (5, 3):
        payload = cdr.encode(make_odometry(log_ns))
        writer.add(ODOMETRY, KEY, payload, log_ns=log_ns, published_ns=0)
        writer.flush()
    writer.finish()
    assert any("log time 3 comes after 5" in text for text in check(tmp_path / "s.mcap").errors)
