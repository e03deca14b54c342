"""Boards of ros_arduino_bridge and its forks, behind a pseudo-terminal."""

import os
import pty
import select
import threading
import time
import tty
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Self

import numpy as np

from .case import Case, Kind
from .targets import board as board_of_a_target
from .targets import write_target

_WRAP = 1 << 16
_ODOMETRY = r"\b[1-9]\d* odometry messages"
Answer = Callable[[int, int], bytes]
"""The bytes for two counts."""


class Board:
    """Answers `e` by its own dialect and all else by `other`, as long as it is entered; `rate`:
    counts a second."""

    def __init__(
        self, answer: Answer, rate: float, begin: int = 0, other: bytes = b"OK\r\n"
    ) -> None:
        self._answer, self._rate, self._begin, self._other = answer, rate, begin, other
        self._ours, self._theirs = pty.openpty()
        tty.setraw(self._ours)
        tty.setraw(self._theirs)
        self.port = os.ttyname(self._theirs)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping.set()
        self._thread.join()
        os.close(self._ours)
        os.close(self._theirs)

    def _run(self) -> None:
        asked_s, held = 0.0, b""
        while not self._stopping.is_set():
            if not select.select([self._ours], [], [], 0.05)[0]:
                continue
            *lines, held = (held + os.read(self._ours, 1000)).split(b"\r")
            for line in filter(None, lines):
                asked_s = asked_s or time.monotonic()  # the program may take long to start
                count = self._begin + int(self._rate * (time.monotonic() - asked_s))
                said = self._answer(count, count) if line == b"e" else self._other
                os.write(self._ours, said)


_READ: tuple[Answer, ...] = (
    lambda left, right: b"%d %d\r\n" % (left, right),
    lambda left, right: b"%d %d\n" % (left, right),
    lambda left, right: b"%d %d \r\n" % (left, right),
    lambda left, right: b"%d %d\r\r\n" % (left, right),
)
"""Dialects that say two counts."""
_REFUSED: Mapping[str, Answer] = {
    "Invalid Command": lambda _left, _right: b"Invalid Command\r\n",
    "counts: ": lambda left, right: b"counts: %d / %d\r\n" % (left, right),
    "hello": lambda _left, _right: b"hello from the motor board\r\n",
    'order = "lrlr"': lambda left, right: b"%d %d %d %d\r\n" % (left, right, left, right),
}
"""Dialects that do not, by what is to be shown of them."""


def _looked_at(
    folder: Path, board: Board, statuses: tuple[int, ...], says: tuple[str, ...], never: str = ""
) -> Case:
    site = folder / "site.toml"
    write_target(folder, board_of_a_target(np.random.default_rng(0)))
    site.write_text(
        'site = "lab"\ntarget = "target.toml"\n[cameras.c1]\nsource = "dir:///x"\n'
        f'horizontal_fov = 60.0\n[robots.r1]\nport = "{board.port}"\nbaud = 57600\n'
        'protocol = "ros_arduino_bridge"\n'
        "[robots.r1.wheels]\ndiameter = 0.1\ntrack = 0.3\nticks = 1000\n",
        encoding="utf-8",
    )
    words = ("robot", "--site", site, "--robot", "r1", "--dry-run")
    return Case(words, statuses, says, tuple(filter(None, [never])), beside=board)


def dialect(folder: Path, random: np.random.Generator) -> Case:
    """Read, and asked at the contract's 20 readings a second or more."""
    board = Board(_READ[random.integers(len(_READ))], random.uniform(100, 900))
    return _looked_at(folder, board, (0,), (r"\b[2-9]\d odometry messages",))


def refused(folder: Path, random: np.random.Generator) -> Case:
    shown = str(random.choice(list(_REFUSED)))
    return _looked_at(folder, Board(_REFUSED[shown], 300), (1,), (shown,), "nothing comes")


def silent(folder: Path, random: np.random.Generator) -> Case:
    board = Board(lambda _left, _right: b"", random.uniform(100, 900), other=b"")
    return _looked_at(folder, board, (1,), ("nothing comes|does not answer|no answer",))


def sixteen_bits(folder: Path, random: np.random.Generator) -> Case:
    """The counters' end comes in the first seconds: what to write is said."""

    def answer(left: int, right: int) -> bytes:
        wrapped = [(count + _WRAP // 2) % _WRAP - _WRAP // 2 for count in (left, right)]
        return b"%d %d\r\n" % tuple(wrapped)

    rate = random.uniform(300, 900)
    board = Board(answer, rate, _WRAP // 2 - int(2.5 * rate))
    return _looked_at(folder, board, (0, 1), (_ODOMETRY, r"16[ -]bit|\bbits = 16"))


BOARDS: Mapping[str, Kind] = {
    "a board's dialect": dialect,
    "a board that refuses": refused,
    "a board that is silent": silent,
    "counters of 16 bits": sixteen_bits,
}
