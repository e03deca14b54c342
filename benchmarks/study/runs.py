"""Works out the sessions of a study that are not there yet, some at a time."""

import multiprocessing
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from dataclasses import dataclass

from .measure import Measure, measured
from .store import Store

ESTIMATORS = ("smoother", "particle", "ekf")
COMPARED = ("drive", "one_picture", "dance", "revisit", "alike")
"""Situations whose sessions all estimators work out."""


@dataclass(frozen=True, slots=True)
class Job:
    """One session."""

    situation: str
    seed: int
    estimator: str = "smoother"

    def measure(self) -> Measure:
        """Simulate it, work it out and measure it."""
        return measured(self.situation, self.seed, estimator=self.estimator)


@dataclass(frozen=True, slots=True)
class Done:
    """A job and what came of it: its measure, or the reason why there is none."""

    job: Job
    result: Measure | BaseException


def jobs_of(situations: list[str], seeds: int, estimators: tuple[str, ...]) -> list[Job]:
    """Every session, seed by seed, so that a study that is cut short has some of each situation."""
    return [
        Job(situation, seed, estimator)
        for seed in range(seeds)
        for situation in situations
        for estimator in estimators
        if estimator == "smoother" or situation in COMPARED
    ]


def open_jobs(store: Store, jobs: list[Job]) -> list[Job]:
    """Those that are not in the store yet."""
    known = {
        Job(m.situation, m.seed, m.estimator)
        for situation in {job.situation for job in jobs}
        for m in store.measures(situation)
    }
    return [job for job in jobs if job not in known]


def run(store: Store, jobs: list[Job], *, processes: int = 2) -> Iterator[Done]:
    """Work the jobs out, keep each measure as it comes, and say so."""
    # Forked processes would share the state of the linear algebra's threads.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, mp_context=context) as pool:
        futures: dict[Future[Measure], Job] = {pool.submit(job.measure): job for job in jobs}
        for future in as_completed(futures):
            reason = future.exception()
            if reason is not None:
                yield Done(futures[future], reason)
                continue
            store.add(future.result())
            yield Done(futures[future], future.result())
