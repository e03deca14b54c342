"""Tables and progress, on a terminal and elsewhere."""

import io
import sys
import time
from contextlib import closing

import pytest

from trigpoint.base import terminal
from trigpoint.base.terminal import Progress, table, waiting

HEAD = ("camera", "sigma cm", "")
ROWS = [("c1", "0.84", ""), ("entrance_hall", "12.30", "not [bold]determined[/bold]")]


class Screen(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_columns_are_aligned_and_a_file_gets_plain_text() -> None:
    lines = table(HEAD, ROWS, left=(0, 2), colours=["", "red"]).splitlines()
    assert lines == [
        "camera         sigma cm",
        "c1                 0.84",
        "entrance_hall     12.30  not [bold]determined[/bold]",
    ]


def test_a_long_row_is_not_broken() -> None:
    assert len(table(("a",), [("x" * 300,)]).splitlines()) == 2


def test_a_terminal_has_colours(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", Screen())
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert "\x1b[31m" in table(HEAD, ROWS, colours=["", "red"])


def test_progress_is_shown_late_and_taken_back(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = Screen()
    now_s = [0.0]
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setattr(terminal.time, "monotonic", lambda: now_s[0])
    with closing(Progress("review", 10)) as progress:
        progress.step(4)
        assert not screen.getvalue()
        now_s[0] = 3.0
        progress.step()
        assert "review" in screen.getvalue()
        assert "50%" in screen.getvalue()
    assert screen.getvalue().endswith("\x1b[2K")  # the line is empty again


def test_progress_says_nothing_into_a_file(capsys: pytest.CaptureFixture[str]) -> None:
    with closing(Progress("review", 2)) as progress:
        progress._due_s = time.monotonic() - 1
        progress.step()
    assert capsys.readouterr().err == ""


def test_what_takes_long_moves_and_is_taken_back(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = Screen()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setattr(terminal, "_QUIET_S", 0.01)
    with waiting("working it out"):
        until_s = time.monotonic() + 20.0
        while "working it out" not in screen.getvalue() and time.monotonic() < until_s:
            time.sleep(0.01)
        first = screen.getvalue()
        while screen.getvalue() == first and time.monotonic() < until_s:
            time.sleep(0.01)
    assert "working it out" in first
    assert len(screen.getvalue()) > len(first)  # by itself
    assert screen.getvalue().endswith("\x1b[2K")


def test_what_is_done_soon_shows_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = Screen()
    monkeypatch.setattr(sys, "stderr", screen)
    with waiting("working it out"):
        pass
    assert screen.getvalue() == ""
