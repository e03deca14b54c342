"""Words for people: numbers with their nouns, the nearest of some names, how far work has come."""

import difflib
import sys
import time
from collections.abc import Iterable, Sequence

_QUIET_S = 2.0
"""What takes no longer needs no word about how far it is."""
_PERIOD_S = 0.5


def counted(number: int, noun: str) -> str:
    """«1 face», «2 faces»."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def nearest(word: str, known: Iterable[str]) -> str:
    """«; did you mean «charuco»?», "" where there is nothing to choose from."""
    close = difflib.get_close_matches(word, list(known), n=1, cutoff=0.0)
    return f"; did you mean «{close[0]}»?" if close else ""


def listed(names: Sequence[str]) -> str:
    """«a, b or c»."""
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} or {names[-1]}"


class Progress:
    """A line on the terminal that says how far work has come, from its third second on; nothing
    where standard error is no terminal."""

    def __init__(self, what: str, total: int | None = None) -> None:
        """`total`: how many steps there are, where that is known."""
        self._what, self._total = what, total
        self._began_s = time.monotonic()
        self._due_s = self._began_s + _QUIET_S
        self._done = 0
        self._width = 0

    def step(self, count: int = 1) -> None:
        """So many steps more are done."""
        self._done += count
        now_s = time.monotonic()
        if now_s >= self._due_s and sys.stderr.isatty():
            self._due_s = now_s + _PERIOD_S
            self._show(f"{self._what}: {self._so_far()}, {now_s - self._began_s:.0f} s")

    def _so_far(self) -> str:
        if not self._total:
            return str(self._done)
        return f"{self._done} of {self._total} ({100 * self._done // self._total} %)"

    def _show(self, text: str) -> None:
        sys.stderr.write(f"\r{text.ljust(self._width)}")
        sys.stderr.flush()
        self._width = len(text)

    def close(self) -> None:
        """Take the line back."""
        if self._width:
            self._show("")
            sys.stderr.write("\r")
            sys.stderr.flush()
            self._width = 0
