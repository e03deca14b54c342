"""The measures of sessions as JSON lines, a file for each situation, so that an interrupted study
goes on where it was.

A line holds the fingerprint of the sources that made it; those of other sources do not count.
"""

import hashlib
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import msgspec

from .measure import Measure

_ROOT = Path(__file__).parents[2]
_SOURCES = ("trigpoint/geometry", "fusion", "tools/simulation", "benchmarks/study")


class _Line(msgspec.Struct, frozen=True):
    sources: str
    measure: Measure


def sources() -> str:
    """A fingerprint of what a measure depends on."""
    return fingerprint(_SOURCES)


@cache
def fingerprint(folders: tuple[str, ...]) -> str:
    """Of the Python files in folders of the project, and in theirs."""
    digest = hashlib.sha256()
    for folder in folders:
        for path in sorted((_ROOT / folder).rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


class Store:
    """The files of a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def add(self, measure: Measure) -> None:
        """Append a line and close the file, so that nothing of it is lost."""
        self.folder.mkdir(parents=True, exist_ok=True)
        line = msgspec.json.encode(_Line(sources(), measure))
        with self._path(measure.situation).open("ab") as file:
            file.write(line + b"\n")

    def measures(self, situation: str, *, of_any_sources: bool = False) -> list[Measure]:
        """What was measured of a situation, each session once."""
        path = self._path(situation)
        if not path.exists():
            return []
        found: dict[tuple[str, int], Measure] = {}
        for line in _decoded(path.read_bytes().splitlines()):
            if of_any_sources or line.sources == sources():
                found[line.measure.estimator, line.measure.seed] = line.measure
        return [found[key] for key in sorted(found)]

    def _path(self, situation: str) -> Path:
        return self.folder / f"{situation}.jsonl"


def _decoded(lines: Iterable[bytes]) -> Iterable[_Line]:
    """The whole lines; the last one of a study that was killed may be torn."""
    for line in lines:
        try:
            yield msgspec.json.decode(line, type=_Line)
        except msgspec.DecodeError:
            continue
