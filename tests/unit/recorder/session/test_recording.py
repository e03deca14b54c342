"""Reading sessions: sound ones, damaged ones, foreign ones."""

import itertools
import logging
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.builders import REAL_DATA, make_odometry

from trigpoint.base.errors import RecordingError
from trigpoint.contract import cdr
from trigpoint.contract.topics import ODOMETRY, SIGHTINGS, Topic
from trigpoint.recorder.mcap.index import read_index
from trigpoint.recorder.mcap.writer import McapWriter
from trigpoint.recorder.session.recording import Recording, open_recording

KEY = ODOMETRY.key("lab", "r1")


def write(path: Path, chunks: list[list[int]], key: str = KEY) -> Path:
    """A session of odometry messages with these log times, chunk by chunk."""
    path.unlink(missing_ok=True)
    writer = McapWriter(path)
    number = 0
    for chunk in chunks:
        for log_ns in chunk:
            payload = cdr.encode(make_odometry(log_ns, x=float(number)))
            writer.add(ODOMETRY, key, payload, log_ns=log_ns, published_ns=number)
            number += 1
        writer.flush()
    writer.finish()
    return path


def log_times(recording: Recording) -> list[int]:
    return [sample.log_ns for sample in recording.samples()]


def test_every_message_comes_back_with_its_bytes_and_times(session_file: Path, story: list) -> None:
    read = {
        (sample.key, sample.topic, sample.payload, sample.published_ns)
        for sample in open_recording(session_file).samples()
    }
    assert read == {(one.key, one.topic, one.payload, one.stamp_ns) for one in story}


def test_attachments_and_counts_are_there(session_file: Path, story: list) -> None:
    recording = open_recording(session_file)
    assert set(recording.attachments) == {"site.toml", "target.toml"}
    assert recording.site_text.startswith('site = "lab"')
    assert sum(recording.counts.values()) == len(story)
    assert recording.counts[KEY] == sum(one.key == KEY for one in story)
    assert recording.start_ns < recording.end_ns
    assert recording.problem == ""


def test_only_the_topics_asked_for_are_read(session_file: Path) -> None:
    topics = {sample.topic for sample in open_recording(session_file).samples([SIGHTINGS])}
    assert topics == {SIGHTINGS}


def test_a_folder_stands_for_the_session_in_it(session_file: Path) -> None:
    assert open_recording(session_file.parent).path == session_file


@given(st.lists(st.lists(st.integers(0, 50), min_size=1, max_size=8), min_size=1, max_size=6))
@settings(
    max_examples=60,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
def test_messages_come_in_log_order_and_stable(tmp_path: Path, chunks: list[list[int]]) -> None:
    recording = open_recording(write(tmp_path / "s.mcap", chunks))
    written = [(log_ns, number) for number, log_ns in enumerate(itertools.chain(*chunks))]
    read = [(sample.log_ns, sample.published_ns) for sample in recording.samples()]
    starts = [min(chunk) for chunk in chunks]
    if starts == sorted(starts):
        assert read == sorted(written)  # messages of one log time keep the file's order
    assert [log_ns for log_ns, _ in read] == sorted(log_ns for log_ns, _ in written)
    assert sorted(read) == sorted(written)


@pytest.mark.parametrize("part", [0.35, 0.99])
def test_a_cut_file_is_read_as_far_as_it_is_complete(
    tmp_path: Path, part: float, caplog: pytest.LogCaptureFixture
) -> None:
    whole = write(tmp_path / "whole.mcap", [[i] for i in range(20)])
    data = whole.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: int(len(data) * part)])
    with caplog.at_level(logging.WARNING):
        recording = open_recording(cut)
        times = log_times(recording)
        log_times(recording)
    assert times == list(range(len(times)))
    assert times
    assert sum(recording.counts.values()) == len(times)
    assert caplog.text.count("not whole") == 1


def test_a_damaged_chunk_is_left_out_and_told_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = write(tmp_path / "s.mcap", [[*range(200)], [*range(200, 400)], [*range(400, 500)]])
    second = read_index(path).chunks[1]
    data = bytearray(path.read_bytes())
    data[second.offset + second.length - 20] ^= 0xFF
    path.write_bytes(data)
    recording = open_recording(path)
    for _ in range(2):
        assert log_times(recording) == [*range(200), *range(400, 500)]
    (told,) = (record for record in caplog.records if record.levelno == logging.ERROR)
    place = f"{path}: the chunk at byte {second.offset} is damaged"
    assert told.getMessage().startswith(place)
    assert "its 200 messages are left out" in told.getMessage()


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (b"", "the file is empty"),
        (b"hello, I am no recording at all", "no MCAP file"),
        (b"\x1f\x8b\x08\0 of something", "gunzip"),
        (b"#ROSBAG V2.0\n and its records", "rosbag reindex"),
        (b"SQLite format 3\0 and its pages", ".db3"),
        (b"\x89MCAP0\r\n", "the session is empty"),
    ],
)
def test_what_is_no_session_is_said_in_one_line(
    tmp_path: Path, content: bytes, complaint: str
) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=complaint) as caught:
        open_recording(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_session_without_messages_is_an_error(make_session: Callable[[list], Path]) -> None:
    with pytest.raises(RecordingError, match="has no messages"):
        open_recording(make_session([]))


def test_a_missing_path_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="no such session"):
        open_recording(tmp_path / "none.mcap")
    with pytest.raises(RecordingError, match=r"no \.mcap file in this folder"):
        open_recording(tmp_path)


def test_a_folder_with_several_sessions_asks_for_one(tmp_path: Path) -> None:
    for name in ("a.mcap", "b.mcap"):
        write(tmp_path / name, [[1]])
    with pytest.raises(RecordingError, match=r"a\.mcap, b\.mcap"):
        open_recording(tmp_path)


def test_a_session_without_a_site_file_asks_for_it(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="--site"):
        _ = open_recording(write(tmp_path / "s.mcap", [[1]])).site_text


def test_it_names_the_site_file_that_lies_beside_the_session(tmp_path: Path) -> None:
    (tmp_path / "site.toml").touch()
    with pytest.raises(RecordingError, match=rf"--site {tmp_path}/site\.toml"):
        _ = open_recording(write(tmp_path / "s.mcap", [[1]])).site_text


def test_keys_that_the_contract_does_not_have_are_left_out(tmp_path: Path) -> None:
    recording = open_recording(write(tmp_path / "s.mcap", [[1, 2]], key="lab/robot/r1/mood"))
    assert recording.unknown_keys == ["lab/robot/r1/mood"]
    assert log_times(recording) == []


def test_a_key_with_another_type_is_an_error(tmp_path: Path) -> None:
    recording = open_recording(write(tmp_path / "s.mcap", [[1]], key=SIGHTINGS.key("lab", "c1")))
    for read in (recording.check_is_session, lambda: log_times(recording)):
        with pytest.raises(RecordingError, match=r"msg/Odometry in cdr, not trigpoint_msgs"):
            read()


@pytest.mark.parametrize("topics", [None, [ODOMETRY]])
def test_a_session_from_elsewhere_is_read(topics: list[Topic] | None) -> None:
    folder = REAL_DATA / "real-odometry" / "robot1"
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there")
    recording = open_recording(folder)
    samples = list(recording.samples(topics))
    expected = recording.counts if topics is None else {KEY: recording.counts[KEY]}
    assert len(samples) == sum(expected.values())
    times = [sample.log_ns for sample in samples]
    assert times == sorted(times)
