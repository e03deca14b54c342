"""The demo as a user runs it: a short drive past two cameras, in a process of its own."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.builders import eventually

from trigpoint.map.network import load_network
from trigpoint.recorder.session.recording import open_recording
from trigpoint.tools.demo.folder import DemoFolder
from trigpoint.tools.demo.run import leads_s

pytestmark = pytest.mark.timeout(400)

PATIENCE_S = 240.0
FILES = (
    "site.toml", "target.toml", "truth.json", "session.mcap", "network.json", "covariance.npz",
    "r1.tum", "session.rrd", "report.html", "demo.json",
)  # fmt: skip


class Demo:
    """A running demo and its folder."""

    def __init__(self, out: Path, *more: str) -> None:
        self.folder = DemoFolder(out)
        command = (sys.executable, "-m", "trigpoint", "demo", "--out", str(out), "--no-viewer")
        self._output = out.with_suffix(".txt")
        with self._output.open("w") as file:
            self.process = subprocess.Popen(
                (*command, *more), stdout=file, stderr=subprocess.STDOUT, cwd=out.parent
            )

    def parts(self) -> dict[str, int]:
        """Part -> process id."""
        processes = dict(self.folder.read().processes)
        del processes["demo"]
        return processes

    def is_up(self) -> bool:
        """Whether every part is at work."""
        return "processes are up" in self._output.read_text()

    def finish(self) -> tuple[int, str]:
        """Its exit status and what it printed."""
        return self.process.wait(PATIENCE_S), self._output.read_text()


@pytest.fixture
def start(tmp_path: Path) -> Iterator[object]:
    demos: list[Demo] = []

    def run(*more: str) -> Demo:
        demos.append(Demo(tmp_path / "demo", *more))
        return demos[-1]

    yield run
    for demo in demos:
        if demo.process.poll() is None:
            demo.process.send_signal(signal.SIGTERM)
            demo.finish()


def is_alive(number: int) -> bool:
    try:
        os.kill(number, 0)
    except ProcessLookupError:
        return False
    return True


def test_busy_machine_is_given_more_time_at_once():
    assert leads_s(0.3, 2) == (6.0, 20.0, 60.0)
    assert leads_s(4.0, 2) == (12.0, 40.0, 60.0)


def test_short_demo_finds_the_cameras_that_it_meets_and_leaves_its_files(start):
    demo = start("--seconds", "11", "--seed", "1")
    status, output = demo.finish()
    assert status == 0, output
    folder = demo.folder.path
    assert [name for name in FILES if not (folder / name).exists()] == []
    network = load_network(folder)
    assert network.cameras["c1"].status == "located"
    assert network.cameras["c6"].status == "unseen"
    assert "not met" in next(line for line in output.splitlines() if line.startswith("c6"))
    recording = open_recording(folder)
    assert recording.problem == ""
    assert {"site.toml", "target.toml", "network.json"} <= recording.attachments.keys()
    assert (folder / "report.html").read_text(encoding="utf-8").startswith("<!doctype html>")
    assert not any(is_alive(number) for number in demo.parts().values())


@pytest.mark.long
def test_killed_parts_are_started_again_and_the_demo_goes_on(start):
    demo = start("--seconds", "20", "--seed", "1")
    assert eventually(demo.is_up, 120.0)
    first = demo.parts()
    time.sleep(4.0)
    for name in ("fusion", "recorder", "edge c1 c3 c5", "robot r1", "firmware r1"):
        os.kill(first[name], signal.SIGKILL)
    status, output = demo.finish()
    assert status == 0, output
    for name in ("fusion", "recorder", "edge c1 c3 c5", "robot r1", "firmware r1"):
        assert f"{name} was ended by SIGKILL; it is started again" in output
        assert f"{name} ended and was started again 1 ×" in output
    assert len(demo.folder.sessions) == 2
    assert load_network(demo.folder.path).cameras["c1"].status == "located"


def test_interrupted_demo_stops_in_order_and_leaves_what_there_is(start):
    demo = start("--seconds", "60")
    assert eventually(demo.is_up, 120.0)
    demo.process.send_signal(signal.SIGINT)
    status, output = demo.finish()
    assert status == 130, output
    assert "stopped; what there is lies in" in output
    assert open_recording(demo.folder.session).problem == ""
    assert json.loads((demo.folder.path / "network.json").read_text())["site"] == "lab"
    assert not any(is_alive(number) for number in demo.parts().values())
