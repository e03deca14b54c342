"""Recording on a thread of its own: what is kept, what is lost, what is said."""

import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from msgspec.structs import replace
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from support.builders import eventually, make_odometry

from trigpoint.base.clock import SystemClock
from trigpoint.base.disk import free_bytes
from trigpoint.base.errors import RecordingError
from trigpoint.contract import cdr
from trigpoint.contract.topics import CAMERA_INFO, CORRECTION, IMAGE, ODOMETRY
from trigpoint.recorder.commands import _say_recorded
from trigpoint.recorder.mcap.check import check
from trigpoint.recorder.mcap.chunk import Compression
from trigpoint.recorder.mcap.writer import McapWriter
from trigpoint.recorder.session.files import CLOCK, LOSSES
from trigpoint.recorder.session.recording import open_recording
from trigpoint.recorder.writing import sink as sink_mcap
from trigpoint.recorder.writing.free_space import Room
from trigpoint.recorder.writing.sink import McapSink, SinkSettings

KEY = ODOMETRY.key("lab", "r1")
PAYLOAD = cdr.encode(make_odometry(1))


def put(sink: McapSink, log_ns: int) -> bool:
    return sink.write(ODOMETRY, KEY, PAYLOAD, log_ns=log_ns, published_ns=log_ns)


def messages_in(path: Path) -> int:
    """How many messages of an unfinished file would be left if its writer were killed now."""
    try:
        return sum(open_recording(path).counts.values())
    except RecordingError:
        return 0


def test_what_was_written_is_in_the_file_in_order(tmp_path: Path) -> None:
    path = tmp_path / "s.mcap"
    with McapSink(path, clock=SystemClock()) as sink:
        sink.attach("site.toml", b"site", "application/toml")
        assert all(put(sink, i) for i in range(500))
    recording = open_recording(path)
    assert [sample.log_ns for sample in recording.samples()] == list(range(500))
    assert recording.attachments == {"site.toml": b"site"}
    assert sink.counts == {KEY: 500}
    assert sink.lost == 0


def test_a_message_reaches_the_file_soon_without_a_full_chunk(tmp_path: Path) -> None:
    path = tmp_path / "s.mcap"
    with McapSink(path, clock=SystemClock()) as sink:
        for number in range(1, 4):
            put(sink, number)
            assert eventually(lambda wanted=number: messages_in(path) == wanted)


def test_a_full_queue_loses_and_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sink_mcap, "QUEUE_BYTES", len(PAYLOAD) - 1)
    with McapSink(tmp_path / "s.mcap", clock=SystemClock()) as sink:
        assert not put(sink, 1)
        assert sink.lost == 1
    assert sink.counts == {}


FULL_DISK = """
import resource, signal, sys, time
from pathlib import Path
import numpy as np
from trigpoint.base.clock import SystemClock
from trigpoint.recorder.writing import sink as sink_mcap
from trigpoint.contract.topics import IMAGE
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (10_000_000, resource.RLIM_INFINITY))
sink_mcap._FIRST_RETRY_S = 0.2
random = np.random.default_rng(0)
said = []
sink = sink_mcap.McapSink(Path(sys.argv[1]), clock=SystemClock(), complain=said.append)
sent = 0
while sink.part < 2:
    noise = random.bytes(100_000)
    sink.write(IMAGE, "lab/camera/c1/image/compressed", noise, log_ns=sent, published_ns=0)
    sent += 1
    time.sleep(0.005)
    if len(said) == 1:  # not even the beginning of the next part fits
        resource.setrlimit(resource.RLIMIT_FSIZE, (4, resource.RLIM_INFINITY))
    if len(said) > 1:  # somebody makes room
        resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY,) * 2)
sink.close()
print(said[0])
print(said[-1] == "", sent == sum(sink.counts.values()), sink.lost == 0)
"""


def test_a_full_disk_is_said_and_the_recording_goes_on_when_there_is_room(tmp_path: Path) -> None:
    path = tmp_path / "s.mcap"
    command = [sys.executable, "-c", FULL_DISK, str(path)]
    said = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    complaint, counted = said.stdout.splitlines()
    assert "writing failed" in complaint
    assert str(path) in complaint
    assert counted == "True True True"
    assert messages_in(path) >= 10
    assert open_recording(tmp_path / "s_part2.mcap").problem == ""
    times = [sample.log_ns for sample in open_recording(tmp_path).samples()]
    assert times == list(range(len(times)))


def test_pictures_do_not_push_out_what_is_small(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A disk that stalls under pictures costs pictures alone, counted by key."""
    monkeypatch.setattr(sink_mcap, "QUEUE_BYTES", 100_000)
    may_write = threading.Event()
    monkeypatch.setattr(McapWriter, "flush", _held(McapWriter.flush, may_write))
    cameras = [IMAGE.key("lab", name) for name in ("c1", "c2")]
    with McapSink(tmp_path / "s.mcap", clock=SystemClock()) as sink:
        assert put(sink, 1)
        assert eventually(lambda: sink.depth == 0)
        time.sleep(0.6)  # the writing thread hangs in the flush of what is half a second old
        for number in range(20):
            key = cameras[number % 2]
            sink.write(IMAGE, key, bytes(20_000), log_ns=2 + number, published_ns=0)
            assert put(sink, 2 + number)
        may_write.set()
    assert sink.counts[KEY] == 21
    assert KEY not in sink.losses
    assert sum(sink.losses[key] + sink.counts.get(key, 0) for key in cameras) == 20
    assert open_recording(tmp_path / "s.mcap").notes[LOSSES] == {
        key: str(count) for key, count in sink.losses.items()
    }


def _held(flush: Callable[[McapWriter], None], may_write: threading.Event):
    def hold(writer: McapWriter) -> None:
        may_write.wait(20)
        flush(writer)

    return hold


def test_a_chunks_messages_are_in_the_order_of_log_time(tmp_path: Path) -> None:
    path = tmp_path / "s.mcap"
    with McapSink(path, clock=SystemClock()) as sink:
        for log_ns in (5, 3, 9, 1):
            put(sink, log_ns)
    assert [s.log_ns for s in open_recording(path).samples()] == [1, 3, 5, 9]
    assert check(path).is_sound


def test_attachments_of_samples_are_in_the_file(tmp_path: Path) -> None:
    path, key = tmp_path / "s.mcap", CORRECTION.key("lab", "r1")
    with McapSink(path, clock=SystemClock()) as sink:
        for number in range(5):
            mark = bytes([number]) * (24 * (number % 2))
            sink.write(CORRECTION, key, b"pose", log_ns=number, published_ns=7, attachment=mark)
    samples = list(open_recording(path).samples())
    assert [s.attachment for s in samples] == [b"", b"\1" * 24, b"", b"\3" * 24, b""]
    assert open_recording(path).counts == {key: 5}
    assert not check(path).errors
    with AnyReader([path], default_typestore=get_typestore(Stores.EMPTY)) as reader:
        beside = [c for c in reader.connections if c.topic == f"/{key}/attachment"]
        read = [reader.deserialize(d, c.msgtype).data for c, _, d in reader.messages(beside)]  # pyright: ignore[reportAttributeAccessIssue] - made at run time
    assert [bytes(data) for data in read] == [b"\1" * 24, b"\3" * 24]


def test_a_clock_that_is_set_back_leaves_log_times_in_order_and_is_noted(tmp_path: Path) -> None:
    path = tmp_path / "s.mcap"
    clock = SettableClock()
    with McapSink(path, clock=clock) as sink:
        put(sink, clock.now_ns())
        assert eventually(lambda: sum(sink.counts.values()) == 1)
        clock.set_back_ns = 3_600 * 10**9
        time.sleep(0.3)
        put(sink, clock.now_ns())
    first, second = [sample.log_ns for sample in open_recording(path).samples()]
    assert 0 < second - first < 5 * 10**9
    ((_, seconds),) = open_recording(path).notes[CLOCK].items()
    assert float(seconds) == pytest.approx(-3600, abs=0.1)


class SettableClock(SystemClock):
    """A machine's clock that somebody sets."""

    set_back_ns = 0

    def now_ns(self) -> int:
        return time.time_ns() - self.set_back_ns


def test_parts_are_one_session_and_each_begins_with_what_late_joiners_get(tmp_path: Path) -> None:
    path, info = tmp_path / "s.mcap", CAMERA_INFO.key("lab", "c1")
    with McapSink(path, clock=SystemClock()) as sink:
        sink.attach("site.toml", b"site", "application/toml")
        sink.write(CAMERA_INFO, info, b"lens", log_ns=1, published_ns=1)
        for part in range(1, 4):
            assert put(sink, 10 * part)
            assert eventually(lambda: sink.depth == 0)
            sink.split()
            assert eventually(lambda wanted=part: sink.part == wanted + 1)
    assert len(list(tmp_path.glob("*.mcap"))) == 4
    third = open_recording(tmp_path / "s_part3.mcap")
    assert third.attachments == {"site.toml": b"site"}
    assert [s.key for s in third.samples()] == [info, KEY]
    whole = list(open_recording(tmp_path).samples())
    assert [(s.key, s.log_ns) for s in whole] == [(info, 1), (KEY, 10), (KEY, 20), (KEY, 30)]
    with AnyReader([tmp_path]) as reader:  # by metadata.yaml, as a bag
        assert reader.message_count == 3 + 4
    assert not any(check(file).errors for file in tmp_path.glob("*.mcap"))


def test_the_oldest_finished_session_makes_room_never_the_running_one(tmp_path: Path) -> None:
    for number, is_finished in enumerate((False, True, True), 1):
        file = tmp_path / f"lab_2026010{number}T000000Z" / "session.mcap"
        with McapSink(file, clock=SystemClock()) as sink:
            put(sink, 1)
        if not is_finished:
            file.write_bytes(file.read_bytes()[:-1])
    (tmp_path / "lab_20260102T000000Z" / "notes.txt").write_text("mine")
    running = tmp_path / "lab_20260103T000000Z"
    room = Room(tmp_path, 1e30, frees_oldest=True, prefix="lab")
    assert "must stay" in room.problem(running)
    left = sorted(
        str(file.relative_to(tmp_path)) for file in tmp_path.rglob("*.*") if file.is_file()
    )
    assert left == [
        "lab_20260101T000000Z/metadata.yaml",
        "lab_20260101T000000Z/session.mcap",
        "lab_20260102T000000Z/notes.txt",
        "lab_20260103T000000Z/metadata.yaml",
        "lab_20260103T000000Z/session.mcap",
    ]
    assert Room(tmp_path, 0.0, frees_oldest=True, prefix="lab").problem(running) == ""


def test_a_file_that_is_being_written_is_not_said_to_be_broken_off(tmp_path: Path) -> None:
    path = tmp_path / "s.mcap"
    with McapSink(path, clock=SystemClock()) as sink:
        assert put(sink, 1)
        assert eventually(lambda: messages_in(path) == 1)
        shutil.copy(path, tmp_path / "killed.mcap")
        assert open_recording(path).problem == "it is still being written"
        assert "there is no footer: it is still being written" in check(path).errors
    assert (open_recording(path).problem, check(path).errors) == ("", [])
    killed = tmp_path / "killed.mcap"
    assert open_recording(killed).problem.startswith("it breaks off at byte ")
    assert "there is no footer: the recording was broken off" in check(killed).errors


@pytest.mark.skipif(not Path("/dev/shm").is_dir(), reason="there is no second disk here")
def test_room_is_asked_of_the_disk_that_is_written_to(tmp_path: Path) -> None:
    with TemporaryDirectory(dir="/dev/shm") as other:
        finished = Path(other) / "lab_20260101T000000Z" / "session.mcap"
        with McapSink(finished, clock=SystemClock()) as sink:
            put(sink, 1)
        least = free_bytes(tmp_path) + free_bytes(Path(other))
        room = Room(Path(other), least, frees_oldest=True, prefix="lab")
        assert room.problem(tmp_path).startswith(f"{tmp_path}: ")
        assert finished.exists()  # its going would make no room there
        (tmp_path / finished.parent.name).symlink_to(finished.parent)
        here = tmp_path / "lab_20260102T000000Z" / "session.mcap"
        with McapSink(here, clock=SystemClock()) as sink:
            put(sink, 1)
        assert replace(room, directory=tmp_path).problem(tmp_path).startswith(f"{tmp_path}: ")
        assert (finished.exists(), here.exists()) == (True, False)


def test_a_session_that_is_a_link_on_the_same_disk_makes_room(tmp_path: Path) -> None:
    finished = tmp_path / "kept" / "session.mcap"
    with McapSink(finished, clock=SystemClock()) as sink:
        put(sink, 1)
    (tmp_path / "lab_20260101T000000Z").symlink_to(finished.parent)
    room = Room(tmp_path, 1e30, frees_oldest=True, prefix="lab")
    assert "must stay" in room.problem(tmp_path)
    assert not finished.exists()


def test_over_the_budget_the_oldest_recordings_go_and_then_finished_parts(tmp_path: Path) -> None:
    files = [tmp_path / f"lab_2026010{day}T000000Z" / "session.mcap" for day in (1, 2)]
    running = tmp_path / "lab_20260103T000000Z"
    parts = [running / f"session{part}.mcap" for part in ("", "_part2", "_part3")]
    (tmp_path / "lab_2_20260101T000000Z").mkdir()
    others = tmp_path / "lab_2_20260101T000000Z" / "session.mcap"
    for file in [others, *files, *parts]:
        with McapSink(file, clock=SystemClock()) as sink:
            put(sink, 1)
    size = parts[0].stat().st_size
    room = Room(tmp_path, 0.0, frees_oldest=False, prefix="lab", budget=3.5 * size)
    assert room.problem(running, parts[:2]) == ""
    assert [file.exists() for file in [*files, *parts]] == [False, False, True, True, True]
    room = replace(room, budget=2.5 * size)
    assert room.problem(running, parts[:2]) == ""
    assert [file.exists() for file in parts] == [False, True, True]
    assert "are allowed (budget" in replace(room, budget=1.5 * size).problem(running, parts[:2])
    assert [file.exists() for file in [others, *parts]] == [True, False, True, True]


def test_a_recording_over_its_budget_goes_on_and_tells_what_is_left(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    room = Room(tmp_path, 0.0, frees_oldest=False, prefix="lab", budget=60_000.0)
    path = tmp_path / "lab_20260101T000000Z" / "session.mcap"
    settings = SinkSettings(compression=Compression.NONE, room=room)
    with McapSink(path, clock=SystemClock(), settings=settings) as sink:
        while path.exists():
            part = sink.part
            assert part < 200
            for number in range(10):  # 7 kB
                put(sink, 10 * part + number)
            sink.split()
            assert eventually(lambda part=part: sink.part > part)
    assert sink.lost == 0
    assert all(file.exists() for file in sink.files)
    assert sink.files[-1] == path.with_name(f"session_part{sink.part}.mcap")
    kept = [sample.log_ns for sample in open_recording(path.parent).samples()]
    assert kept == list(range(kept[0], 10 * sink.part))
    _say_recorded(sink)
    removed = sink.part - len(sink.files)
    assert f"of {sink.part} files the oldest {removed} made room" in capsys.readouterr().out


class Midnight(SystemClock):
    """A clock that is set to just before midnight, and may be moved on."""

    late_ns = 0

    def now_ns(self) -> int:
        return 20_000 * 86_400_000_000_000 - 1_000_000_000 + self.late_ns


def test_a_new_file_begins_with_each_day_and_what_is_removed_is_in_no_list(tmp_path: Path) -> None:
    clock, path = Midnight(), tmp_path / "lab_20241003T000000Z" / "session.mcap"
    room = Room(tmp_path, 0.0, frees_oldest=False, prefix="lab")
    with McapSink(path, clock=clock, settings=SinkSettings(daily=True, room=room)) as sink:
        put(sink, clock.now_ns())
        assert eventually(lambda: sink.depth == 0)
        assert sink.part == 1
        clock.late_ns = 2_000_000_000
        assert eventually(lambda: sink.part == 2)
        put(sink, clock.now_ns())
        path.unlink()  # as a room with a budget does it
        assert eventually(lambda: not sink._facts)
    with AnyReader([path.parent]) as reader:
        assert reader.message_count == 1


def test_a_recording_without_room_waits_and_goes_on(tmp_path: Path) -> None:
    path, said = tmp_path / "s.mcap", []
    room = FullAtFirst(tmp_path, 1e30, frees_oldest=False, prefix="lab")
    settings = SinkSettings(room=room)
    with McapSink(path, clock=SystemClock(), settings=settings, complain=said.append) as sink:
        put(sink, 1)
        assert eventually(lambda: bool(sink.problem))
        put(sink, 2)
        assert eventually(lambda: sink.part == 2)
    assert [s.log_ns for s in open_recording(tmp_path).samples()] == [1, 2]
    assert said[-1] == ""


class FullAtFirst(Room, frozen=True):
    """A disk on which room is made after the first look."""

    def problem(self, running: Path, finished: Iterable[Path] = ()) -> str:
        if running in _LOOKED:
            return ""
        _LOOKED.add(running)
        return super().problem(running, finished)


_LOOKED: set[Path] = set()
