"""One log of all parts: each line behind the name of the part that said it.

A part is never held up by who reads the log: a full queue drops lines and counts them.
"""

import os
import queue
import threading
import time
from collections import deque
from typing import BinaryIO, TextIO, cast

from trigpoint.base.closing import Closing

from .output import last_words

_MOST_LINES = 2000
_LONGEST_LINE = 4000
_KEPT_LINES = 20
_READ_S = 1.0
"""How long the rest of an ended part's words may take to come through its pipe."""


class JoinedLog(Closing):
    """Writes to `stream` on a thread of its own, in the order in which lines come."""

    def __init__(self, stream: TextIO, *, width: int) -> None:
        """`width`: of the column of names."""
        self._stream, self._width = stream, width
        self._lines: queue.Queue[str | None] = queue.Queue(_MOST_LINES)
        self._lost, self._counting = 0, threading.Lock()
        self._pipes: list[_Pipe] = []
        self.is_broken = False
        self._writer = threading.Thread(target=self._write, name="joined log", daemon=True)
        self._writer.start()

    def output(self, name: str) -> "_Pipe":
        """Where a part of this name writes."""
        pipe = _Pipe(name, self)
        self._pipes.append(pipe)
        return pipe

    def say(self, name: str, line: str) -> None:
        """One line in a part's name; any thread, never waits."""
        try:
            self._lines.put_nowait(f"{name:<{self._width}} | {line}\n")
        except queue.Full:
            with self._counting:
                self._lost += 1

    def drain(self) -> None:
        """Wait, for a moment at most, until all that ended parts wrote is among the lines."""
        until_s = time.monotonic() + _READ_S
        for pipe in self._pipes:
            pipe.drain(until_s)

    def close(self) -> None:
        """Write what was said so far, as far as somebody takes it; the parts have ended."""
        self.drain()
        try:
            self._lines.put(None, timeout=_READ_S)
        except queue.Full:
            return
        self._writer.join(_READ_S)

    def _write(self) -> None:
        try:
            while (line := self._lines.get()) is not None:
                self._stream.write(self._loss() + line)
                self._stream.flush()
            self._stream.write(self._loss())
            self._stream.flush()
        except (OSError, ValueError):  # who read it has gone
            self.is_broken = True

    def _loss(self) -> str:
        """A line that says how many were lost since the last one, "" for none."""
        with self._counting:
            lost, self._lost = self._lost, 0
        return f"({lost} lines were lost: nobody took them in time)\n" if lost else ""


class _Pipe:
    """The pipe of one part, which is read on a thread of its own. A part that is started again
    gets a new one."""

    where = ""

    def __init__(self, name: str, log: JoinedLog) -> None:
        self._name, self._log = name, log
        self._tail: deque[bytes] = deque(maxlen=_KEPT_LINES)
        self._reader: threading.Thread | None = None

    def attach(self) -> BinaryIO:
        ours, theirs = os.pipe()
        source = cast(BinaryIO, os.fdopen(ours, "rb"))
        self._reader = threading.Thread(
            target=self._read, args=(source,), name=f"log of {self._name}", daemon=True
        )
        self._reader.start()
        return cast(BinaryIO, os.fdopen(theirs, "wb"))

    def last_line(self) -> str:
        self.drain(time.monotonic() + _READ_S)
        return last_words(list(self._tail))

    def drain(self, until_s: float) -> None:
        """Wait until all is read that an ended part wrote, at most to a monotonic time."""
        if self._reader is not None:
            self._reader.join(max(0.0, until_s - time.monotonic()))

    def _read(self, source: BinaryIO) -> None:
        with source:
            while line := source.readline(_LONGEST_LINE):
                self._tail.append(line)
                self._log.say(self._name, line.decode(errors="replace").rstrip())
