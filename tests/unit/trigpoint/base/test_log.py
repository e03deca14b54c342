"""How log lines look: on a terminal and in systemd's journal."""

import logging
import os
import re
from pathlib import Path

from trigpoint.base.log import formatter


def record(level: int) -> logging.LogRecord:
    return logging.LogRecord("trigpoint.node.node", level, "f", 1, "it runs", None, None)


def test_line_has_date_and_zone(tmp_path: Path) -> None:
    with (tmp_path / "log").open("w") as stream:
        line = formatter(stream, {}).format(record(logging.INFO))
    assert re.fullmatch(
        r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d{3}[+-]\d{4} info trigpoint.node.node: it runs", line
    )


def test_line_in_the_journal_has_its_priority_and_no_time(tmp_path: Path) -> None:
    with (tmp_path / "journal").open("w") as stream:
        status = os.fstat(stream.fileno())
        journal = {"JOURNAL_STREAM": f"{status.st_dev}:{status.st_ino}"}
        lines = [formatter(stream, journal).format(record(level)) for level in (20, 30, 40)]
        elsewhere = formatter(stream, {"JOURNAL_STREAM": "8:1"}).format(record(logging.INFO))
    assert lines[0] == "<6>info trigpoint.node.node: it runs"
    assert [line[:3] for line in lines] == ["<6>", "<4>", "<3>"]
    assert not elsewhere.startswith("<")
