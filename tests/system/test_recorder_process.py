"""The recorder, replay and the viewer as a user starts them: processes on a real bus."""

import logging
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from support.builders import TARGET_TEXT, eventually, make_odometry, make_site, site_text
from support.commands import Cli

from trigpoint.bus.bus import Bus
from trigpoint.contract import cdr
from trigpoint.contract.topics import DIAGNOSTICS, ODOMETRY
from trigpoint.recorder.session.recording import open_recording
from trigpoint.zenoh import open_bus

KEY = ODOMETRY.key("lab", "r1")
PERIOD_S = 0.01


class Desk:
    """A site's folder, and a bus that the processes connect to."""

    def __init__(self, folder: Path, bus: Bus, stack: ExitStack) -> None:
        self.folder, self.bus, self._stack = folder, bus, stack
        text = site_text(bus=f"connect = {list(bus.locators)}")
        (folder / "site.toml").write_text(text)
        (folder / "target.toml").write_text(TARGET_TEXT)

    def start(self, *words: str) -> subprocess.Popen[str]:
        """Start `trigpoint …` in the folder."""
        process = subprocess.Popen(
            [sys.executable, "-m", "trigpoint", *words],
            cwd=self.folder,
            stdout=subprocess.PIPE,
            text=True,
        )
        self._stack.callback(end, process)
        return process

    def start_recorder(self) -> subprocess.Popen[str]:
        process = self.start("record", "--site", "site.toml", "--out", "out")
        assert process.stdout is not None
        assert process.stdout.readline().startswith("recording site lab")
        return process


def end(process: subprocess.Popen[str]) -> None:
    process.kill()
    process.communicate(timeout=60)


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    with ExitStack() as stack:
        site = make_site(bus='listen = ["tcp/127.0.0.1:0"]')
        bus = stack.enter_context(open_bus(site))
        yield Desk(tmp_path, bus, stack)


@contextmanager
def driving(bus: Bus) -> Iterator[list[int]]:
    """A robot that sends odometry a hundred times a second; yields the times of what was sent."""
    sent: list[int] = []
    stopping = threading.Event()
    publisher = bus.publisher(ODOMETRY, KEY)
    assert eventually(lambda: publisher.has_listener)

    def drive() -> None:
        while not stopping.wait(PERIOD_S):
            now_ns = time.time_ns()
            publisher.put(cdr.encode(make_odometry(now_ns)))
            sent.append(now_ns)

    thread = threading.Thread(target=drive, name="drive")
    thread.start()
    try:
        yield sent
    finally:
        stopping.set()
        thread.join()
        is_sent = bus.flush(60)  # closing has no time for a busy machine
        publisher.close()
    assert is_sent


def odometry_stamps(path: Path) -> list[int]:
    stamps = []
    for sample in open_recording(path).samples([ODOMETRY]):
        message = cdr.decode(ODOMETRY.type_name, sample.payload)
        stamps.append(message.stamp_ns)  # pyright: ignore[reportAttributeAccessIssue] - an Odometry
    return stamps


def test_a_killed_recorder_loses_at_most_a_second_and_another_goes_on_in_a_file_of_its_own(
    desk: Desk, caplog: pytest.LogCaptureFixture
) -> None:
    process = desk.start_recorder()
    with driving(desk.bus) as sent:
        assert eventually(lambda: len(sent) > 250)
        process.send_signal(signal.SIGKILL)
        killed_ns = time.time_ns()
        process.wait(60)
        before = [stamp for stamp in sent if stamp <= killed_ns]
        again = desk.start_recorder()
        count = len(sent)
        assert eventually(lambda: len(sent) > count + 50)
    again.send_signal(signal.SIGTERM)
    assert again.wait(60) == 0
    with caplog.at_level(logging.WARNING):
        recorded = odometry_stamps(desk.folder / "out" / "session.mcap")
    assert recorded == before[: len(recorded)] or recorded == before[-len(recorded) :]
    lost = [stamp for stamp in before if stamp > recorded[-1]]
    assert len(lost) <= 1.0 / PERIOD_S
    assert "not whole" in caplog.text
    second = desk.folder / "out" / "session_2.mcap"
    assert odometry_stamps(second)[-1] == sent[-1]
    assert open_recording(second).problem == ""


def test_a_recorder_that_is_stopped_has_everything_which_replayed_is_recorded_again(
    desk: Desk, tmp_path: Path
) -> None:
    recorder = desk.start_recorder()
    with driving(desk.bus) as sent:
        assert eventually(lambda: len(sent) > 100)
    recorder.send_signal(signal.SIGINT)
    said, _ = recorder.communicate(timeout=60)
    assert recorder.returncode == 0
    assert odometry_stamps(desk.folder / "out") == sent
    assert f"{len(sent)}  {KEY}" in said
    first = tmp_path / "first.mcap"
    (desk.folder / "out" / "session.mcap").rename(first)
    recorder = desk.start_recorder()
    player = desk.start("replay", str(first), "--rate", "4", "--site", "site.toml")
    said, _ = player.communicate(timeout=60)
    assert player.returncode == 0
    assert f"{len(sent)}  {KEY}" in said
    recorder.send_signal(signal.SIGTERM)
    recorder.communicate(timeout=60)
    again = open_recording(desk.folder / "out")
    topics = [ODOMETRY]
    assert [s.payload for s in again.samples(topics)] == [
        s.payload for s in open_recording(first).samples(topics)
    ]
    assert DIAGNOSTICS.key("lab") in again.counts


def test_a_view_ends_in_order(desk: Desk) -> None:
    process = desk.start("view", "--site", "site.toml", "--web", "--port", "0")
    assert process.stdout is not None
    assert "http://127.0.0.1:" in process.stdout.readline()
    with driving(desk.bus) as sent:
        assert eventually(lambda: len(sent) > 50)
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 0


@pytest.mark.parametrize(
    "words",
    [("replay", "foreign.mcap"), *(("review", f"{n}.mcap") for n in ("foreign", "nothing"))],
)
def test_a_wrong_session_is_said_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli, words: tuple[str, str]
) -> None:
    (tmp_path / "foreign.mcap").write_text("this is no recording")
    monkeypatch.chdir(tmp_path)
    [line] = cli.refused(*words).splitlines()
    assert words[1] in line
