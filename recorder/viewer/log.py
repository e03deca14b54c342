"""The scene's log: what happened, with its time."""

from datetime import UTC, datetime

import rerun as rr

from trigpoint.base.clock import NANOSECONDS

from . import style
from .columns import Columns


class LogLine:
    """Writes a line into the scene's log."""

    def __init__(self, columns: Columns) -> None:
        self._columns = columns

    def __call__(self, stamp_ns: int, level: str, text: str) -> None:
        # The log's own column of times is too narrow to be read, and cannot be widened.
        time = datetime.fromtimestamp(stamp_ns // NANOSECONDS, UTC).strftime("%H:%M:%S")
        said = f"{time} {text}"
        self._columns.row(style.LOG, stamp_ns, rr.TextLog, text=[said], level=[level])
