"""What came of sessions as JSON lines, a file for each situation, so that an interrupted study goes
on where it was; and the sessions that are not there yet, worked out some at a time.

A line holds the fingerprint of the sources that made it; those of other sources do not count.
"""

import hashlib
import signal
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
from msgspec.structs import replace

from benchmarks.timing import ended

from .result import Outcome, Result
from .work import Job, last_line

ESTIMATORS = ("smoother", "particle", "ekf")
COMPARED = ("drive", "one_picture", "dance", "revisit", "alike")
"""Situations whose sessions all estimators work out."""
# By the clock, on a busy machine: for a program's start and a session's drawing; and in multiples
# of the processor time that is allowed.
_DRAWN_S, _PATIENCE = 300.0, 8.0
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


def run(store: Store, jobs: list[Job], *, processes: int, limit_s: float) -> Iterator[Result]:
    """Work the jobs out, so many at a time, and keep each result as it comes; not of those that
    were stopped, which are tried again."""
    with ThreadPoolExecutor(processes) as threads:
        futures = [threads.submit(bounded, job, limit_s) for job in jobs]
        try:
            for future in as_completed(futures):
                result = future.result()
                if result.outcome is not Outcome.STOPPED:
                    store.add(result)
                yield result
        finally:
            threads.shutdown(cancel_futures=True)


def bounded(job: Job, limit_s: float) -> Result:
    """The result by a process of the job's own, within a limit of processor time, and with a folder
    for what it leaves behind."""
    words = (job.session, str(job.seed), job.estimator, str(limit_s))
    # Sessions are worked out side by side, and leave nothing for linear algebra's threads.
    one = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    module, most_s = "benchmarks.study.work", _DRAWN_S + _PATIENCE * limit_s
    with TemporaryDirectory() as folder:
        environment = {**one, "TMPDIR": folder}
        status, told, said = ended(module, *words, environment=environment, most_s=most_s)
    results = list(_results(told))
    if status == 0 and told.count(b"\n") == len(results) == 2:
        return results[1]
    blank = results[0] if results else Result(job.session, job.seed, 0.0, estimator=job.estimator)
    if status == -signal.SIGPROF:
        return replace(blank, outcome=Outcome.LATE, seconds=limit_s)
    if status is None:
        return replace(blank, outcome=Outcome.STOPPED, why=f"after {most_s:.0f} s by the clock")
    is_its_own = status >= 0 or -status in (signal.SIGSEGV, signal.SIGABRT)
    why = f"exit {status}: {last_line(said or told.decode(errors='replace'))}"[:160]
    return replace(blank, outcome=Outcome.FAILED if is_its_own else Outcome.STOPPED, why=why)


def _results(told: bytes) -> Iterator[Result]:
    """Those that a process printed, up to the first line that is none: cut, or another's."""
    with suppress(ValueError):  # msgspec's errors, and Unicode's
        for line in told.splitlines():
            yield msgspec.json.decode(line, type=Result)
