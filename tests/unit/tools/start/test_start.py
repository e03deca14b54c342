"""`trigpoint start`, with its answers on standard input."""

import io
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import pytest
from support.commands import Cli, Said

from trigpoint.base.errors import InputError
from trigpoint.cli import run
from trigpoint.site.config import load_site
from trigpoint.site.target import load_target
from trigpoint.tools.start import command as module
from trigpoint.tools.start import hardware
from trigpoint.tools.start.questions import Question, Questions

Start = Callable[..., Said]


class Become(BaseException):
    """The process went on as another command."""


@pytest.fixture
def ran(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """The commands that were run, as users write them; the last may be what start became."""
    lines: list[list[str]] = []
    real = subprocess.run

    def noted(command: tuple[str, ...], *, check: bool) -> "subprocess.CompletedProcess[bytes]":
        lines.append(list(command[command.index("trigpoint") + 1 :]))
        return real(command, check=check)

    def become(path: str, command: tuple[str, ...]) -> NoReturn:
        assert path == command[0] == sys.executable
        lines.append(list(command[command.index("trigpoint") + 1 :]))
        raise Become

    monkeypatch.setattr(module.subprocess, "run", noted)
    monkeypatch.setattr(module.os, "execv", become)
    return lines


@pytest.fixture
def start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli) -> Start:
    """Runs it in a folder of its own, on a machine without devices."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(hardware, "cameras", list)
    monkeypatch.setattr(hardware, "ports", list)
    (tmp_path / "pictures").mkdir()

    def answered(*answers: str, words: tuple[str, ...] = (), status: int = 0) -> Said:
        monkeypatch.setattr(sys, "stdin", io.StringIO("".join(f"{line}\n" for line in answers)))
        return cli("start", *words, status=status)

    return answered


def test_camera_robot_and_target_lead_to_a_site_that_is_started(
    start: Start, ran: list[list[str]], tmp_path: Path
) -> None:
    (tmp_path / "port").touch()
    port = str(tmp_path / "port")
    with pytest.raises(Become):
        start("pictures", port, "create2", "box 0.3x0.4", "n", "y")
    site = load_site(tmp_path / "site.toml")
    assert site.camera("c1").source == f"dir://{tmp_path}/pictures"
    assert (site.robot("r1").port, site.robot("r1").protocol) == (port, "create2")
    assert len(load_target(tmp_path / "target.toml").faces) == 4
    assert [line[0] for line in ran] == ["target", "init", "up"]
    assert ran[-1] == ["up", "--site", "site.toml"]


def test_look_is_for_the_sites_target_and_no_password_is_shown(
    start: Start,
    ran: list[list[str]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def ended(command: tuple[str, ...], *, check: bool) -> "subprocess.CompletedProcess[bytes]":
        assert not check
        ran.append(list(command[command.index("trigpoint") + 1 :]))
        return subprocess.CompletedProcess(command, 0)

    assert run(["target", "make", "--board", "--out", str(tmp_path / "target.toml")]) == 0
    camera = '[cameras.c1]\nsource = "rtsp://me:secret@hall/1"\n'
    (tmp_path / "site.toml").write_text(f'site = "lab"\ntarget = "target.toml"\n{camera}')
    monkeypatch.setattr(module.subprocess, "run", ended)
    shown = start("y", "n").out
    assert ran == [["look", "rtsp://me:secret@hall/1", "--target", "target.toml"]]
    assert "rtsp://hall/1" in shown
    assert "secret" not in shown


def test_missing_robot_is_simulated_beside_the_camera(
    start: Start, ran: list[list[str]], tmp_path: Path
) -> None:
    with pytest.raises(Become):
        start("pictures", "none", "planes", "n", "")
    assert ran[-1] == ["up", "--site", "site.toml", "--simulate-robot", "--out", "simulated"]
    assert len(load_target(tmp_path / "target.toml").faces) == 6


def test_who_has_nothing_gets_a_simulated_site_and_no_file(
    start: Start, ran: list[list[str]], tmp_path: Path
) -> None:
    with pytest.raises(Become):
        start(words=("--yes",))
    assert ran == [["up", "--simulate-robot", "--out", "simulated"]]
    assert not (tmp_path / "site.toml").exists()


def test_nothing_is_started_against_a_no(start: Start, ran: list[list[str]]) -> None:
    said = start("none", "n").out
    assert ran == []
    assert "when you are ready: trigpoint up --simulate-robot" in said


def test_files_that_are_there_are_kept(start: Start, ran: list[list[str]], tmp_path: Path) -> None:
    assert run(["target", "make", "--board", "--out", str(tmp_path / "target.toml")]) == 0
    before = (tmp_path / "target.toml").read_bytes()
    start("pictures", "none", "n", "n")
    assert (tmp_path / "target.toml").read_bytes() == before
    assert [line[0] for line in ran] == ["init"]
    site = (tmp_path / "site.toml").read_bytes()
    assert "site.toml is there and stays as it is" in start("n", "n").out
    assert (tmp_path / "site.toml").read_bytes() == site


def test_answers_that_end_are_one_clear_line(start: Start, ran: list[list[str]]) -> None:
    said = start("pictures", status=2).err
    assert "the answers ended at «What is the robot connected to" in said
    assert ran == []


def test_command_that_fails_ends_it(start: Start, ran: list[list[str]], tmp_path: Path) -> None:
    (tmp_path / "target.pdf").touch()  # `target make` replaces nothing
    said = start("pictures", "none", "board", status=1).err
    assert "`trigpoint target make --board" in said
    assert not (tmp_path / "site.toml").exists()


def test_wrong_answer_is_asked_again_but_not_for_ever() -> None:
    screen = io.StringIO()
    question = Question("What carries the boards?", "planes", hardware.target_words)
    answers = io.StringIO("box 30x30\nbox\nbox 0.3x0.4\n")
    assert Questions(screen, answers).ask(question) == "--box 0.3x0.4"
    assert "in metres" in screen.getvalue()
    with pytest.raises(InputError, match="begin again"):
        Questions(screen, io.StringIO("wrong\n" * 9)).ask(question)


def test_defaults_are_what_is_here_but_never_a_port(tmp_path: Path) -> None:
    (tmp_path / "serial/by-id").mkdir(parents=True)
    for name in ("video2", "video0", "ttyUSB0", "serial/by-id/usb-robot"):
        (tmp_path / name).touch()
    assert hardware.cameras(tmp_path) == [f"{tmp_path}/video0", f"{tmp_path}/video2"]
    assert hardware.ports(tmp_path) == [f"{tmp_path}/serial/by-id/usb-robot"]


@pytest.mark.parametrize(
    ("answer", "source"),
    [
        ("/dev/video0", "v4l2:///dev/video0"),
        ("rtsp://hall/1", "rtsp://hall/1"),
        ("/clips/a.mp4", "file:///clips/a.mp4"),
        ("none", "none"),
    ],
)
def test_camera_is_said_as_the_site_file_writes_it(answer: str, source: str) -> None:
    assert hardware.camera_source(answer, exists=lambda _: True) == source


def test_what_is_not_here_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no /dev/video9 here"):
        hardware.camera_source("/dev/video9", exists=lambda _: False)
    with pytest.raises(InputError, match="there is no /dev/ttyUSB9 here"):
        hardware.robot_port("/dev/ttyUSB9", exists=lambda _: False)
    with pytest.raises(InputError, match="write trigpoint, create2, mavlink or"):
        hardware.robot_protocol("rosserial")
