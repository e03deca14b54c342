"""Durations of jobs, measured in turns, so that other work on the machine meets all of them."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import TypeVar

from trigpoint.base.clock import SystemClock

ROUNDS = 7
_Name = TypeVar("_Name")
_Result = TypeVar("_Result")


class WorkClock(SystemClock):
    """Counts the work of the thread that asks, so that no picture is given up since others keep the
    machine busy."""

    def elapsed_ns(self) -> int:
        """Processor time of this thread."""
        return time.thread_time_ns()


def timed(job: Callable[[], _Result]) -> tuple[float, _Result]:
    """How long a job took, seconds, and its result; for jobs that wait or have threads."""
    began = time.perf_counter()
    result = job()
    return time.perf_counter() - began, result


def in_new_process(job: Callable[..., _Result], *arguments: object) -> _Result:
    """What a job gives in a process of its own, whose memory and first times are then the job's."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(job, *arguments).result()


def ended(
    module: str, *words: str, environment: Mapping[str, str], most_s: float, sent: bytes = b""
) -> tuple[int | None, bytes, str]:
    """A module as a program that is `sent` its input: its exit status, output and what it says is
    wrong. The status is None where it is killed since it takes longer than `most_s` by the clock.
    """
    try:
        child = subprocess.run(
            [sys.executable, "-m", module, *words],
            input=sent,
            capture_output=True,
            env=os.environ | environment,
            timeout=most_s,
            check=False,
        )
    except subprocess.TimeoutExpired as late:
        return None, late.stdout or b"", ""
    return child.returncode, child.stdout, child.stderr.decode(errors="replace")


def worked(job: Callable[[], _Result]) -> tuple[float, _Result]:
    """How long this process worked on a job of one thread, seconds, and its result.

    On a busy machine that is what the job costs; the rest is waiting for a core.
    """
    began = time.process_time()
    result = job()
    return time.process_time() - began, result


def worked_s(process: int) -> float:
    """The processor's time of another process so far, seconds."""
    ticks = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[11:13]
    return sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK")


def resident_mb(process: int | str) -> float:
    """What of another process's memory is resident, MB; «self»: of this one."""
    pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def family(process: int) -> list[int]:
    """A process and all that it began; raises OSError once it has ended."""
    begun = Path(f"/proc/{process}/task/{process}/children").read_text().split()
    return [process, *(each for child in begun for each in family(int(child)))]


def best_of(
    rounds: int, jobs: Mapping[_Name, Callable[[], _Result]]
) -> dict[_Name, tuple[float, _Result]]:
    """Of each job the least seconds of work over some rounds, in which all take turns, and its
    first result.

    The best, since whatever else the machine does can only add to a duration.
    """
    turns = [{name: worked(job) for name, job in jobs.items()} for _ in range(rounds)]
    return {name: (min(turn[name][0] for turn in turns), turns[0][name][1]) for name in jobs}


def side_by_side(
    ours: Callable[[], object], other: Callable[[], object], *, times: int
) -> tuple[float, float]:
    """Seconds of work a call of both, the best of some turns, each of so many calls."""

    def repeat(job: Callable[[], object], times: int) -> None:
        for _ in range(times):
            job()

    for job in (ours, other):  # the first call of a kind also builds what is kept
        job()
    best = best_of(ROUNDS, {job: partial(repeat, job, times) for job in (ours, other)})
    return best[ours][0] / times, best[other][0] / times
