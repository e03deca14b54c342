"""The time that a stop may take."""

import subprocess
import sys
import time
from signal import SIGINT, SIGTERM, Signals

import pytest

from trigpoint.base.ending import STOP_S, Ending

HANGS = """
import signal, sys, time
from trigpoint import cli
from trigpoint.node.node import stop_on_signals
class Callback:
    def __del__(self) -> None:
        hang()
def hang() -> None:
    print("ready", flush=True)
    time.sleep(600)
def main() -> None:
    if sys.argv[1] == "starts":
        hang()
    if sys.argv[1] == "is in a callback of Python's own":
        Callback()
    stop_on_signals([])
    print("ready", flush=True)
    if sys.argv[1] == "writes":
        from trigpoint.base.ending import ENDING
        with ENDING.writing():
            time.sleep(3.5)
            print("written", flush=True)
    time.sleep(600)
kind = sys.argv[1]
sys.argv[1:] = ["edge"]
sys.argv.append(kind)
cli.COMMANDS["edge"] = cli.Command("__main__:command", "Hangs.", service=True)
def command(kind: str) -> None:
    sys.argv[1] = kind
    main()
if __name__ == "__main__":
    cli.main()
"""


def stopped(kind: str, number: Signals = SIGTERM) -> tuple[int, float, str]:
    """How a program that hangs ends after a signal: status, seconds, what it said."""
    process = subprocess.Popen(
        [sys.executable, "-c", HANGS, kind],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    began_s = time.monotonic()
    process.send_signal(number)
    said, _ = process.communicate(timeout=200)
    return process.returncode, time.monotonic() - began_s, said


@pytest.mark.parametrize(
    ("kind", "number"), [("starts", SIGINT), ("is in a callback of Python's own", SIGTERM)]
)
def test_service_that_has_nothing_to_close_yet_ends_at_once(kind: str, number: Signals) -> None:
    status, _, said = stopped(kind, number)
    assert (status, said) == (0, "")


def test_program_that_hangs_ends_all_the_same() -> None:
    status, took_s, _ = stopped("hangs")
    assert status == 1
    assert took_s < 30 * STOP_S  # it would have gone on for ten minutes


def test_file_that_is_being_written_is_finished() -> None:
    status, _, said = stopped("writes")
    assert status == 1
    assert said.startswith("written\n")


def test_what_is_left_is_counted_from_the_first_time_it_is_asked() -> None:
    ending = Ending()
    assert ending.left_s() == float("inf")
    ending.ask()
    left_s = ending.left_s()
    ending.ask()
    assert ending.left_s() <= left_s
    assert 0 < ending.left_s(0.5) <= STOP_S - 0.5
    assert ending.left_s(STOP_S) == 0.0
    ending.forget()
    assert not ending.is_asked
