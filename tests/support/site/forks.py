"""Programs of ours as processes that start at once: one that has imported them forks for each.

`ForkedPrograms` runs this file. On standard input come JSON lines: what to start (words, version,
log), or whose end to wait for; on standard output the process, or its status. A test that starts a
dozen programs would else import them a dozen times.
"""

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from signal import SIGKILL

from trigpoint.base.closing import Closing


class ForkedPrograms(Closing):
    """The process that forks; what it started ends with it."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._process = subprocess.Popen(
            [sys.executable, __file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self._living: set[int] = set()

    def start(self, name: str, words: Sequence[str], version: str = "") -> int:
        """Start a command, or «firmware»; its process. `version`: what it says that it is."""
        log = str(self._folder / f"{name}.log")
        number = self._ask({"words": list(words), "version": version, "log": log})
        self._living.add(number)
        return number

    def stop(self, number: int) -> int:
        """Tell it to stop as the service manager does; its exit status."""
        os.kill(number, 15)
        status = self._ask({"wait": number})
        self._living.discard(number)
        return os.waitstatus_to_exitcode(status)

    def _ask(self, what: dict[str, object]) -> int:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(what) + "\n")
        self._process.stdin.flush()
        return int(self._process.stdout.readline())

    def said(self, name: str) -> str:
        return (self._folder / f"{name}.log").read_text(errors="replace")

    def close(self) -> None:
        for number in self._living:
            os.killpg(number, SIGKILL)
        self._process.kill()
        self._process.communicate()


def _serve() -> None:
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    import trigpoint.edge.command
    import trigpoint.fusion.command
    import trigpoint.recorder.commands
    import trigpoint.robot.command
    import trigpoint.tools.secure.router
    import trigpoint.tools.simulation.frames
    import trigpoint.tools.simulation.serial.firmware  # noqa: F401

    for line in sys.stdin:
        asked = json.loads(line)
        if "wait" in asked:
            _answer(os.waitpid(asked["wait"], 0)[1])
            continue
        child = os.fork()
        if not child:
            _be(asked)
        _answer(child)


def _answer(number: int) -> None:
    sys.stdout.write(f"{number}\n")
    sys.stdout.flush()


def _be(asked: dict[str, str | list[str]]) -> None:
    """Become the program; does not return."""
    import typer

    from trigpoint import cli
    from trigpoint.node import node
    from trigpoint.tools.simulation.serial import firmware

    os.setsid()
    nothing = os.open(os.devnull, os.O_RDONLY)
    log = os.open(str(asked["log"]), os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    for ours, theirs in ((nothing, 0), (log, 1), (log, 2)):
        os.dup2(ours, theirs)
    if asked["version"]:
        node.__version__ = str(asked["version"])  # pyright: ignore[reportAttributeAccessIssue]
    words = list(asked["words"])
    sys.argv = ["trigpoint", *words]
    if words[0] == "firmware":
        sys.argv = words
        typer.run(firmware.main)
    cli.main()


if __name__ == "__main__":
    _serve()
