"""What came of sessions as JSON lines, a file for each situation, so that an interrupted study goes
on where it was; and the sessions that are not there yet, worked out some at a time.

A line holds the fingerprint of the sources that made it; those of other sources do not count.
"""

import hashlib
import multiprocessing
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from functools import cache
from pathlib import Path
from typing import TypeVar

import msgspec
from msgspec import Struct

from benchmarks.compositions.recipe import KINDS
from benchmarks.compositions.score import Score, scored

from .measure import Measure, measured

T = TypeVar("T", bound=Measure | Score)
ESTIMATORS = ("smoother", "particle", "ekf")
COMPARED = ("drive", "one_picture", "dance", "revisit", "alike")
"""Situations whose sessions all estimators work out."""
_ROOT = Path(__file__).parents[2]
_SOURCES = (
    "trigpoint/geometry",
    "fusion",
    "native/src",
    "tools/simulation",
    "benchmarks/study",
    "benchmarks/compositions",
)


class _Line(msgspec.Struct, frozen=True):
    sources: str
    result: Measure | Score


@cache
def sources() -> str:
    """A fingerprint of what a result depends on."""
    digest = hashlib.sha256()
    for folder in _SOURCES:
        for path in sorted((_ROOT / folder).rglob("*.[pch]*")):
            if path.suffix in (".py", ".cpp", ".hpp"):
                digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


class Store:
    """The files of a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def add(self, result: Measure | Score) -> None:
        """Append a line and close the file, so that nothing of it is lost."""
        self.folder.mkdir(parents=True, exist_ok=True)
        line = msgspec.json.encode(_Line(sources(), result))
        with self._path(result.situation).open("ab") as file:
            file.write(line + b"\n")

    def kept(self, situation: str, of: type[T], *, of_any_sources: bool = False) -> list[T]:
        """What there is of a situation, each session once."""
        path = self._path(situation)
        found: dict[tuple[str, int], T] = {}
        for text in path.read_bytes().splitlines() if path.exists() else ():
            try:
                line = msgspec.json.decode(text, type=_Line)
            except msgspec.DecodeError:
                continue  # the last one of a study that was killed may be torn
            if isinstance(line.result, of) and (of_any_sources or line.sources == sources()):
                found[line.result.estimator, line.result.seed] = line.result
        return [found[key] for key in sorted(found)]

    def _path(self, situation: str) -> Path:
        return self.folder / f"{situation}.jsonl"


class Job(Struct, frozen=True):
    """One session of a situation, or of a kind of composition."""

    situation: str
    seed: int
    estimator: str = "smoother"

    def result(self, limit_s: float) -> Measure | Score:
        """Draw it, work it out and judge it; `limit_s`: processor time of a composition."""
        if self.situation in KINDS:
            return scored(self.situation, self.seed, limit_s=limit_s)
        return measured(self.situation, self.seed, estimator=self.estimator)


def jobs_of(situations: list[str], seeds: range, estimators: tuple[str, ...]) -> list[Job]:
    """Every session, seed by seed, so that a study that is cut short has some of each situation."""
    return [
        Job(situation, seed, estimator)
        for seed in seeds
        for situation in situations
        for estimator in estimators
        if estimator == "smoother" or situation in COMPARED
    ]


def open_jobs(store: Store, jobs: list[Job]) -> list[Job]:
    """Those that are not in the store yet."""
    known = {
        Job(one.situation, one.seed, one.estimator)
        for situation in {job.situation for job in jobs}
        for one in store.kept(situation, Score if situation in KINDS else Measure)
    }
    return [job for job in jobs if job not in known]


def run(
    store: Store, jobs: list[Job], *, processes: int, limit_s: float
) -> Iterator[tuple[Job, Measure | Score | BaseException]]:
    """Work the jobs out and keep each result as it comes; say it, or why there is none."""
    # Forked processes would share the state of the linear algebra's threads.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, mp_context=context) as pool:
        futures: dict[Future[Measure | Score], Job] = {
            pool.submit(job.result, limit_s): job for job in jobs
        }
        for future in as_completed(futures):
            reason = future.exception()
            if reason is None:
                store.add(future.result())
            yield futures[future], reason or future.result()
