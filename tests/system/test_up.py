"""`trigpoint up` as a user runs it who has no robot yet: everything in one command."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from support.builders import eventually

from trigpoint.recorder.session.recording import open_recording

pytestmark = pytest.mark.timeout(300)

STOP_LIMIT_S = 30.0


def children(number: int) -> list[int]:
    """The processes that a process started."""
    text = Path(f"/proc/{number}/task/{number}/children").read_text(encoding="ascii")
    return [int(word) for word in text.split()]


def is_alive(number: int) -> bool:
    return Path(f"/proc/{number}").exists()


def test_simulated_robot_is_seen_and_one_stop_ends_every_part(tmp_path: Path) -> None:
    log = tmp_path / "up.log"
    words = (sys.executable, "-m", "trigpoint", "up", "--simulate-robot")
    with log.open("w") as file:
        up = subprocess.Popen(words, stdout=file, stderr=subprocess.STDOUT, cwd=tmp_path)
    try:
        assert eventually(lambda: "sees the target" in log.read_text() or up.poll() is not None, 90)
        assert up.poll() is None, log.read_text()
        parts = children(up.pid)
        assert len(parts) >= 5
        time.sleep(3.0)  # it drives, and that is recorded
        began_s = time.monotonic()
        up.send_signal(signal.SIGINT)
        assert up.wait(STOP_LIMIT_S) == 0, log.read_text()
        assert time.monotonic() - began_s < STOP_LIMIT_S
    finally:
        if up.poll() is None:
            os.kill(up.pid, signal.SIGTERM)
            up.wait(STOP_LIMIT_S)
    text = log.read_text()
    assert not any(map(is_alive, parts))
    assert "was killed" not in text
    nodes = ("edge/c2", "robot/r1", "recorder/main", "fusion/fusion")
    ends = [text.index(f"{node} stopped") for node in nodes]
    assert ends == sorted(ends)
    [session] = (tmp_path / "simulated/sessions").glob("*/session.mcap")
    counts = open_recording(session).counts
    assert counts["simulated/robot/r1/odom"] > 100
