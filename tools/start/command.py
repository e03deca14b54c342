"""The command `trigpoint start`."""

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from trigpoint.base.errors import OperationError, writing
from trigpoint.edge.sources.frames import without_password
from trigpoint.site.config import load_site
from trigpoint.tools.parts.specs import trigpoint

from . import hardware
from .hardware import NONE
from .questions import Question, Questions

_TARGET = "box 0.30x0.30"


def main(
    directory: Annotated[
        Path, typer.Option(help="Where the site's files are, or are to be.", file_okay=False)
    ] = Path(),
    yes: Annotated[bool, typer.Option("--yes", help="Take the default of every question.")] = False,
) -> None:
    """Ask what you have (a camera? a robot? a target?), and go on to corrections with it.

    Every step is another command, which is shown as it is run: init, target make, look, up. Files
    that are there are kept. What you do not have is simulated. Answers are read from standard
    input, one a line.
    """
    questions = Questions(sys.stdout, None if yes else sys.stdin)
    with writing(directory):
        directory.mkdir(parents=True, exist_ok=True)
    site = directory / "site.toml"
    if site.exists():
        typer.echo(f"{site} is there and stays as it is")
    else:
        _make_site(questions, directory)
    if site.exists():
        _look(questions, site)
        _go_up(questions, directory, ("--site", str(site)))
    else:
        _go_up(questions, directory, ())


def _make_site(questions: Questions, directory: Path) -> None:
    """Write a site of what there is; none where there is no camera."""
    found = hardware.cameras()
    text = "Where do a camera's pictures come from: /dev/video0, rtsp://…, a video, or none?"
    camera = Question(text, found[0] if found else NONE, hardware.camera_source)
    source = questions.ask(camera)
    if source == NONE:
        return
    words = ["init", "--directory", str(directory), "--camera", source]
    words += _robot_words(questions)
    target = directory / "target.toml"
    if target.exists():
        typer.echo(f"{target} is there and stays as it is")
        _run(*words, "--keep-target")
        return
    text = "What carries the boards: box LxW (metres along and across), planes, or board?"
    option = questions.ask(Question(text, _TARGET, hardware.target_words))
    _run("target", "make", *option.split(), "--out", str(target))
    _run(*words, "--keep-target")


def _robot_words(questions: Questions) -> list[str]:
    """What is known of the robot. No port is the default: nothing is sent to a device that nobody
    named."""
    found = hardware.ports()
    here = f"; here are {', '.join(found)}" if found else ""
    text = f"What is the robot connected to: a port, or none{here}?"
    port = questions.ask(Question(text, NONE, hardware.robot_port))
    if port == NONE:
        return []
    text = f"What does it speak: {', '.join(hardware.PROTOCOLS)}?"
    protocol = questions.ask(Question(text, "trigpoint", hardware.robot_protocol))
    return ["--robot", port, "--protocol", protocol]


def _look(questions: Questions, site: Path) -> None:
    """A page that shows what the first camera sees."""
    loaded = load_site(site)
    source = next(iter(loaded.cameras.values())).source
    target = [word for name in loaded.target_names[:1] for word in ("--target", loaded.path(name))]
    text = f"Look at {without_password(source)} first? Ctrl-C there goes on here"
    if questions.confirm(text, default=False):
        _run("look", source, *map(str, target), is_service=True)


def _go_up(questions: Questions, directory: Path, site: tuple[str, ...]) -> None:
    """End as `up`, with a simulated robot where there is no real one."""
    words = ["up", *site]
    if not site or not _has_robot(Path(site[1])):
        typer.echo("no robot is here: a simulated one drives past simulated cameras")
        words += ["--simulate-robot", "--out", str(directory / "simulated")]
    if questions.confirm("Start everything now?", default=True):
        _become(*words)
    typer.echo(f"when you are ready: trigpoint {' '.join(words)}")


def _has_robot(site: Path) -> bool:
    """Whether a robot of the site can be reached from this machine."""
    loaded = load_site(site)
    return any(
        robot.port is None or "://" in robot.port or loaded.path(robot.port).exists()
        for robot in loaded.robots.values()
    )


def _run(*words: str, is_service: bool = False) -> None:
    """Run another command and show it. Raises OperationError where it fails; a service is ended by
    Ctrl-C, which is not for us then."""
    shown = " ".join(map(without_password, words))
    typer.echo(f"$ trigpoint {shown}")
    sys.stdout.flush()
    before = signal.signal(signal.SIGINT, lambda *_: None) if is_service else None
    try:
        status = subprocess.run(trigpoint(*words), check=False).returncode
    finally:
        if is_service:
            signal.signal(signal.SIGINT, before)
    if status and not is_service:
        raise OperationError(f"`trigpoint {shown}` failed; see what it says above")


def _become(*words: str) -> NoReturn:
    """Go on as another command, which is this process from then on."""
    typer.echo(f"$ trigpoint {' '.join(words)}")
    sys.stdout.flush()
    command = trigpoint(*words)
    os.execv(command[0], command)
