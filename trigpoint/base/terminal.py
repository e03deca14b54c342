"""Tables and progress on a terminal, both drawn with rich.

If the output is not a terminal, tables are plain text of any width and no progress is shown. rich
is imported only when needed: half of the commands never use it.
"""

import io
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
_NO_LIMIT = 1000


def table(
    head: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    left: Collection[int] = (0,),
    styles: Sequence[str] = (),
) -> str:
    """Aligned rows below a header. `left`: numbers of the left-aligned columns; `styles`: each
    row's rich style, "" for none; files and pipes get no styles."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    is_terminal = sys.stdout.isatty()
    shown = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
    for number, name in enumerate(head):
        shown.add_column(Text(name), justify="left" if number in left else "right", no_wrap=True)
    for number, row in enumerate(rows):
        style = styles[number] if styles else ""
        shown.add_row(*(Text(cell) for cell in row), style=style or None)
    # At full width: a row broken in two is harder to read than one that scrolls.
    console = Console(file=io.StringIO(), width=_NO_LIMIT, force_terminal=is_terminal)
    with console.capture() as captured:
        console.print(shown)
    return "\n".join(line.rstrip() for line in captured.get().splitlines())


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
