"""The scores of sessions as JSON lines, a file for each kind, so that an interrupted run goes on
where it was. A line holds the fingerprint of the sources that made it; others do not count."""

from pathlib import Path

import msgspec

from benchmarks.study.store import fingerprint

from .score import Score

_SOURCES = ("trigpoint/geometry", "fusion", "tools/simulation", "benchmarks/compositions")


class _Line(msgspec.Struct, frozen=True):
    sources: str
    score: Score


def keep(folder: Path, score: Score) -> None:
    """Append a score and close the file, so that nothing of it is lost."""
    folder.mkdir(parents=True, exist_ok=True)
    line = msgspec.json.encode(_Line(fingerprint(_SOURCES), score))
    with _path(folder, score.kind).open("ab") as file:
        file.write(line + b"\n")


def kept(folder: Path, kind: str, *, of_any_sources: bool = False) -> list[Score]:
    """What is there of a kind, each seed once."""
    path = _path(folder, kind)
    if not path.exists():
        return []
    found: dict[int, Score] = {}
    for text in path.read_bytes().splitlines():
        try:
            line = msgspec.json.decode(text, type=_Line)
        except msgspec.DecodeError:
            continue  # the last one of a run that was killed may be torn
        if of_any_sources or line.sources == fingerprint(_SOURCES):
            found[line.score.seed] = line.score
    return [found[seed] for seed in sorted(found)]


def _path(folder: Path, kind: str) -> Path:
    return folder / f"{kind}.jsonl"
