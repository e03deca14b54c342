"""Parts under one log and one stop. The signals are this process's own."""

import io
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from support.builders import eventually

from trigpoint.base.errors import OperationError
from trigpoint.tools.parts.supervisor import PartSpec
from trigpoint.tools.up.run import run_parts

SLEEPS = "import os, time; print(os.getpid(), flush=True); time.sleep(60)"
SLOW = """
import os, signal, sys, time
def end(*_):
    time.sleep(0.3)
    print("ended", flush=True)
    sys.exit(0)
signal.signal(15, end)
print(os.getpid(), flush=True)
time.sleep(60)
"""
STUBBORN = """
import os, signal, time
signal.signal(15, signal.SIG_IGN)
print(os.getpid(), flush=True)
time.sleep(60)
"""


def spec(name: str, code: str, rank: int = 0) -> PartSpec:
    return PartSpec(name, (sys.executable, "-c", code), rank)


class Told(io.StringIO):
    """The log, and what is done once it says something, in order: (words, what is done)."""

    def __init__(self, *reactions: tuple[Callable[[str], bool], Callable[[], None]]) -> None:
        super().__init__()
        self._reactions = list(reactions)

    def write(self, text: str) -> int:
        written = super().write(text)
        while self._reactions and self._reactions[0][0](self.getvalue()):
            self._reactions.pop(0)[1]()
        return written

    @property
    def numbers(self) -> list[int]:
        """The processes, in the order in which they said their numbers."""
        words = [line.partition("| ")[2] for line in self.getvalue().splitlines()]
        return [int(word) for word in words if word.isdecimal()]

    @property
    def lines(self) -> list[str]:
        return self.getvalue().splitlines()


def said(count: int) -> Callable[[str], bool]:
    """Whether so many processes have said their numbers."""
    return lambda text: sum(line.split("| ")[-1].isdecimal() for line in text.splitlines()) >= count


def signalled(number: signal.Signals) -> Callable[[], None]:
    return lambda: os.kill(os.getpid(), number)


def is_alive(number: int) -> bool:
    """Whether a process runs; one that has ended may wait for its new parent to take notice."""
    try:
        text = Path(f"/proc/{number}/stat").read_text(encoding="ascii", errors="replace")
    except OSError:
        return False
    return text.rpartition(")")[2].split()[0] != "Z"


@pytest.fixture(autouse=True)
def handlers_are_put_back() -> Iterator[None]:
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    yield
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_stop_ends_all_in_the_order_of_their_ranks(number: signal.Signals) -> None:
    log = Told((said(3), signalled(number)))
    run_parts([spec("last", SLOW, 2), spec("first", SLOW, 1), spec("too", SLOW, 1)], log)
    ends = [line.split()[0] for line in log.lines if line.endswith("| ended")]
    assert sorted(ends[:2]) == ["first", "too"]
    assert ends[2:] == ["last"]
    assert log.lines[-1] == "up    | all parts have ended"
    assert not any(map(is_alive, log.numbers))


def test_part_that_does_not_stay_alive_ends_all() -> None:
    log = Told()
    with pytest.raises(OperationError, match="b ended with status 1: on fire, 6 times"):
        run_parts([spec("a", SLEEPS), spec("b", "import sys; sys.exit('on fire')")], log)
    assert not any(map(is_alive, log.numbers))


def test_second_stop_kills_what_does_not_hear_the_first() -> None:
    log = Told(
        (said(1), signalled(signal.SIGINT)),
        (lambda text: "stopping" in text, signalled(signal.SIGINT)),
    )
    began_s = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        run_parts([spec("a", STUBBORN)], log)
    assert time.monotonic() - began_s < 5
    assert not any(map(is_alive, log.numbers))


def test_a_hangup_that_is_ignored_stays_so(tmp_path: Path) -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        log = Told((said(1), signalled(signal.SIGHUP)))
        timer = threading.Timer(1.0, signalled(signal.SIGTERM))
        timer.start()
        began_s = time.monotonic()
        run_parts([spec("a", SLEEPS)], log)
        assert time.monotonic() - began_s > 0.9
        timer.join()
    finally:
        signal.signal(signal.SIGHUP, before)


@pytest.mark.skipif(shutil.which("setpriv") is None, reason="no setpriv here")
def test_nothing_is_left_behind_where_it_is_killed() -> None:
    code = f"""
import sys
from trigpoint.tools.parts.supervisor import PartSpec
from trigpoint.tools.up.run import run_parts
run_parts([PartSpec("a", (sys.executable, "-c", {SLEEPS!r}))], sys.stdout)
"""
    words = [sys.executable, "-c", code]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as up:
        assert up.stdout is not None
        lines = iter(up.stdout.readline, "")
        number = next(int(word) for line in lines if (word := line.split()[-1]).isdecimal())
        assert is_alive(number)
        up.kill()
    assert eventually(lambda: not is_alive(number), 20)


def test_log_that_nobody_takes_any_more_ends_all() -> None:
    class Gone(io.StringIO):
        def write(self, text: str) -> int:
            raise BrokenPipeError

    with pytest.raises(OperationError, match="nobody takes the log"):
        run_parts([spec("a", SLEEPS)], Gone())
    assert eventually(lambda: not any(t.name.startswith("log of") for t in threading.enumerate()))
