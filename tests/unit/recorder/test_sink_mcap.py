"""Recording on a thread of its own: what is kept, what is lost, what is said."""

import subprocess
import sys
from pathlib import Path

import pytest
from builders import eventually, make_odometry

from trigpoint import cdr
from trigpoint.clock import SystemClock
from trigpoint.errors import RecordingError
from trigpoint.recorder import sink_mcap
from trigpoint.recorder.recording import open_recording
from trigpoint.recorder.sink_mcap import McapSink
from trigpoint.topics import ODOMETRY

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
from trigpoint.clock import SystemClock
from trigpoint.errors import OperationError
from trigpoint.recorder.sink_mcap import McapSink
from trigpoint.topics import IMAGE
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (3_000_000, 3_000_000))
random = np.random.default_rng(0)
sink = McapSink(Path(sys.argv[1]), clock=SystemClock())
try:
    for number in range(3000):
        noise = random.bytes(100_000)
        sink.write(IMAGE, "lab/camera/c1/image/compressed", noise, log_ns=number, published_ns=0)
        time.sleep(0.005)
except OperationError as reason:
    print(reason)
try:
    sink.close()
except OperationError as reason:
    print(reason)
"""


def test_a_full_disk_is_said_and_what_was_written_stays(tmp_path: Path) -> None:
    path = tmp_path / "s.mcap"
    command = [sys.executable, "-c", FULL_DISK, str(path)]
    said = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    first, second = said.stdout.splitlines()
    assert "writing failed" in first
    assert str(path) in first
    assert first == second
    assert 10 <= messages_in(path) <= 30
