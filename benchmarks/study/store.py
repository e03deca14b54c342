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

import msgspec
from msgspec import Struct

from benchmarks.compositions.recipe import KINDS

from .measure import measured
from .result import Result
from .score import scored

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
    result: Result


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

    def add(self, result: Result) -> None:
        """Append a line and close the file, so that nothing of it is lost."""
        self.folder.mkdir(parents=True, exist_ok=True)
        line = msgspec.json.encode(_Line(sources(), result))
        with self._path(result.session).open("ab") as file:
            file.write(line + b"\n")

    def kept(self, name: str) -> list[Result]:
        """What there is of a situation or a kind of composition, each session once."""
        path = self._path(name)
        found: dict[tuple[str, int], Result] = {}
        for text in path.read_bytes().splitlines() if path.exists() else ():
            try:
                line = msgspec.json.decode(text, type=_Line)
            except msgspec.DecodeError:
                continue  # the last one of a study that was killed may be torn
            if line.sources == sources():
                found[line.result.estimator, line.result.seed] = line.result
        return [found[key] for key in sorted(found)]

    def _path(self, name: str) -> Path:
        return self.folder / f"{name}.jsonl"


class Job(Struct, frozen=True):
    """One session of a situation, or of a kind of composition."""

    session: str
    seed: int
    estimator: str = "smoother"

    def result(self, limit_s: float) -> Result:
        """Draw it, work it out and judge it; `limit_s`: processor time of a composition."""
        if self.session in KINDS:
            return scored(self.session, self.seed, limit_s=limit_s)
        return measured(self.session, self.seed, estimator=self.estimator)


def jobs_of(names: list[str], seeds: range, estimators: tuple[str, ...]) -> list[Job]:
    """Every session, seed by seed, so that a study that is cut short has some of each."""
    return [
        Job(name, seed, estimator)
        for seed in seeds
        for name in names
        for estimator in estimators
        if estimator == "smoother" or name in COMPARED
    ]


def open_jobs(store: Store, jobs: list[Job]) -> list[Job]:
    """Those that are not in the store yet."""
    known = {
        Job(one.session, one.seed, one.estimator)
        for name in {job.session for job in jobs}
        for one in store.kept(name)
    }
    return [job for job in jobs if job not in known]


def run(
    store: Store, jobs: list[Job], *, processes: int, limit_s: float
) -> Iterator[tuple[Job, Result | BaseException]]:
    """Work the jobs out and keep each result as it comes; say it, or why there is none."""
    # Forked processes would share the state of the linear algebra's threads.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, mp_context=context) as pool:
        futures: dict[Future[Result], Job] = {pool.submit(job.result, limit_s): job for job in jobs}
        for future in as_completed(futures):
            reason = future.exception()
            if reason is None:
                store.add(future.result())
            yield futures[future], reason or future.result()
