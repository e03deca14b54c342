"""What people see on a terminal: tables, and how far work has come; rich draws both.

Where the output is no terminal, tables are plain text as wide as they are, and nothing is said of
progress. rich is imported when it is needed: half of the commands never do.
"""

import io
import sys
import time
from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

_QUIET_S = 2.0
"""What takes no longer needs no word about how far it is."""
_PERIOD_S = 0.5
_NO_LIMIT = 1000


def table(
    head: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    left: Collection[int] = (0,),
    styles: Sequence[str] = (),
) -> str:
    """Rows below a head, aligned; `left`: numbers of the columns of words; `styles`: each row's
    colour in rich's words, "" for none, which a file or a pipe does not get."""
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
    # As wide as it is: a row that is broken into two is harder to read than one that scrolls.
    console = Console(file=io.StringIO(), width=_NO_LIMIT, force_terminal=is_terminal)
    with console.capture() as captured:
        console.print(shown)
    return "\n".join(line.rstrip() for line in captured.get().splitlines())


class Progress:
    """A line on the terminal that says how far work has come, from its third second on; nothing
    where standard error is no terminal."""

    def __init__(self, what: str, total: float | None = None) -> None:
        """`total`: how many steps there are, where that is known."""
        self._what, self._total = what, total
        self._due_s = time.monotonic() + _QUIET_S
        self._done = 0.0
        self._bar: Bar | None = None

    def step(self, count: float = 1) -> None:
        """So many steps more are done."""
        self._done += count
        now_s = time.monotonic()
        if now_s < self._due_s or not sys.stderr.isatty():
            return
        self._due_s = now_s + _PERIOD_S
        if self._bar is None:
            self._bar = self._started()
        task = self._bar.tasks[0].id
        self._bar.update(task, completed=self._done, refresh=True)

    def _started(self) -> "Bar":
        from rich.console import Console
        from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn
        from rich.progress import Progress as Bar

        columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn())
        bar = Bar(
            *columns,
            TimeElapsedColumn(),
            console=Console(stderr=True),
            transient=True,
            auto_refresh=False,  # by `step`: no thread of its own
        )
        bar.add_task(self._what, total=self._total)
        bar.start()
        return bar

    def close(self) -> None:
        """Take the line back."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None
