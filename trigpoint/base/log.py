"""Log lines on standard error: time, level, where, what.

On a terminal or in a file with date, time and zone. Under systemd, whose journal adds the time,
with the priority instead (sd-daemon(3)).
"""

import logging
import os
import sys
from collections.abc import Mapping
from datetime import datetime
from enum import StrEnum
from typing import TextIO

_TEXT = "%(levelname)s %(name)s: %(message)s"
_PRIORITIES = {logging.DEBUG: 7, logging.INFO: 6, logging.WARNING: 4, logging.ERROR: 3}
_WORST = 2


class Level(StrEnum):
    """Names of the log's levels."""

    DEBUG = "debug"
    INFO = "info"
    WARNING = "warning"
    ERROR = "error"


class _Worded(logging.Formatter):
    """Level, logger, message; the level as `--log-level` writes it."""

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802 - logging's name
        worded = {**vars(record), "levelname": record.levelname.lower()}
        return super().formatMessage(logging.makeLogRecord(worded))


class _Timed(_Worded):
    """2026-03-01 14:05:59.123+0100."""

    def formatTime(  # noqa: N802 - logging's name
        self,
        record: logging.LogRecord,
        datefmt: str | None = None,  # noqa: ARG002
    ) -> str:
        moment = datetime.fromtimestamp(record.created).astimezone()
        return f"{moment:%Y-%m-%d %H:%M:%S}.{int(record.msecs):03d}{moment:%z}"


class _Journal(_Worded):
    """Each line begins with its priority, including those of a traceback."""

    def format(self, record: logging.LogRecord) -> str:
        priority = _PRIORITIES.get(record.levelno, _WORST if record.levelno > logging.ERROR else 7)
        return "\n".join(f"<{priority}>{line}" for line in super().format(record).splitlines())


def set_up(level: Level) -> None:
    """Send the program's log to standard error; of other libraries only warnings and above."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(formatter(sys.stderr, os.environ))
    logging.basicConfig(handlers=[handler], level=logging.WARNING, force=True)
    logging.getLogger("trigpoint").setLevel(level.upper())


def formatter(stream: TextIO, environment: Mapping[str, str]) -> logging.Formatter:
    """The line format for a stream."""
    if _is_journal(stream, environment):
        return _Journal(_TEXT)
    return _Timed(f"%(asctime)s {_TEXT}")


def _is_journal(stream: TextIO, environment: Mapping[str, str]) -> bool:
    """Whether a stream goes to systemd's journal. The variable names its device and inode
    (systemd.exec(5)), because child processes inherit it with other streams."""
    named = environment.get("JOURNAL_STREAM", "")
    try:
        status = os.fstat(stream.fileno())
    except (OSError, ValueError):
        return False
    return named == f"{status.st_dev}:{status.st_ino}"
