"""Commands as a user runs them, in this process, and what they say."""

from typing import NamedTuple

import pytest

from trigpoint.cli import run


class Said(NamedTuple):
    out: str
    err: str


class Cli:
    """`cli("info", path).out`; words may be paths and numbers."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self._capsys = capsys

    def __call__(self, *words: object, status: int = 0) -> Said:
        """What the command says; the test fails where it ends otherwise."""
        self._capsys.readouterr()
        ended = run([str(word) for word in words])
        out, err = self._capsys.readouterr()
        said = Said(out, err)
        assert ended == status, f"status {ended}: {said.err}"
        return said

    def refused(self, *words: object) -> str:
        """The one line on standard error of a command that ends with status 2."""
        said = self(*words, status=2)
        assert said.out == ""
        assert said.err.count("\n") == 1
        return said.err
