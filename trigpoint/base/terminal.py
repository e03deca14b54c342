"""Tables and progress on a terminal.

If the output is not a terminal, tables are plain text and no progress is shown. rich draws the
progress, and is imported only then: most runs show none.
"""

import os
import sys
import threading
import time
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

_QUIET_S = 2.0
"""Shorter work shows no progress."""
_PERIOD_S = 0.5
_GAP = "  "
_BOLD = 1
_COLOURS = {"red": 31, "yellow": 33}
"""As a terminal has them (ECMA-48, select graphic rendition)."""


def table(
    head: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    left: Collection[int] = (0,),
    colours: Sequence[str] = (),
) -> str:
    """Aligned rows below a header, each on one line however long. `left`: numbers of the
    left-aligned columns; `colours`: each row's, "" for none; files and pipes get none."""
    widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
    lines = [_GAP.join(_aligned(row, widths, left)).rstrip() for row in (head, *rows)]
    if not sys.stdout.isatty() or "NO_COLOR" in os.environ or os.environ.get("TERM") == "dumb":
        return "\n".join(lines)
    codes = [_BOLD, *(_COLOURS.get(colour, 0) for colour in colours or [""] * len(rows))]
    return "\n".join(
        f"\x1b[{code}m{line}\x1b[0m" if code else line
        for code, line in zip(codes, lines, strict=True)
    )


def _aligned(row: Sequence[str], widths: Sequence[int], left: Collection[int]) -> Iterator[str]:
    for number, (cell, width) in enumerate(zip(row, widths, strict=True)):
        yield cell.ljust(width) if number in left else cell.rjust(width)


class Progress:
    """A progress line on the terminal, from the third second on; nothing if standard error is not a
    terminal."""

    def __init__(self, what: str, total: float | None = None) -> None:
        """`total`: the number of steps, if known."""
        self._what, self._total = what, total
        self._due_s = time.monotonic() + _QUIET_S
        self._done = 0.0
        self._bar: Bar | None = None

    def step(self, count: float = 1) -> None:
        """Advance by so many steps."""
        self._done += count
        now_s = time.monotonic()
        if now_s < self._due_s or not sys.stderr.isatty():
            return
        self._due_s = now_s + _PERIOD_S
        if self._bar is None:
            self._bar = _started(self._what, self._total)
        task = self._bar.tasks[0].id
        self._bar.update(task, completed=self._done, refresh=True)

    def close(self) -> None:
        """Remove the line."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None


@contextmanager
def waiting(what: str) -> Iterator[None]:
    """A line that moves and says how long it has been, from the third second on, while something
    is done of which nobody knows how far it is; nothing if standard error is not a terminal."""
    bars: list[Bar] = []
    timer = threading.Timer(_QUIET_S, lambda: bars.append(_started(what, None)))
    if sys.stderr.isatty():
        timer.start()
    try:
        yield
    finally:
        timer.cancel()
        if timer.is_alive():
            timer.join()
        for bar in bars:
            bar.stop()


def _started(what: str, total: float | None) -> "Bar":
    """A line on the terminal; one without a total is refreshed by a thread of its own."""
    from rich.console import Console
    from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    columns = [TextColumn("{task.description}"), BarColumn()]
    bar = Bar(
        *columns,
        *([TaskProgressColumn()] if total is not None else []),
        TimeElapsedColumn(),
        console=Console(stderr=True),
        transient=True,
        auto_refresh=total is None,
    )
    bar.add_task(what, total=total)
    bar.start()
    return bar
