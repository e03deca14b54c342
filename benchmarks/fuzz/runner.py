"""Children that do the work, batch by batch, and what becomes of one that ends badly."""

import os
import pickle
import re
import signal
import threading
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from msgspec import Struct, field
from msgspec.structs import replace

from benchmarks.timing import ended

from .child import Work
from .inputs import drawn

BATCH = 2000
# Of a child, with its start, on a busy machine; a single input's is processor time.
MOST_WALL_S = 900.0
MOST_BAD = 50
OPTIONS = {
    # Python keeps what it has until it ends; what nobody can allocate is refused as it is without.
    "ASAN_OPTIONS": "detect_leaks=0:allocator_may_return_null=1:max_allocation_size_mb=4096"
    ":quarantine_size_mb=16",
    "UBSAN_OPTIONS": "print_stacktrace=1",
}


class Ending(Struct, frozen=True):
    """How a child ended: `number` of the input it was at; `report` what it said, if that is bad."""

    number: int
    report: str = ""

    @property
    def is_bad(self) -> bool:
        return bool(self.report)

    @property
    def place(self) -> str:
        """What tells one fault from another: the line of our sources, if there is any."""
        named = re.search(r"native/src/\S+|Error: .*|took more .*", self.report)
        return named.group() if named else self.report[-200:]


class Found(Struct):
    """What all children did: how many inputs, how many of them ended badly, where."""

    inputs: int = 0
    bad: int = 0
    places: set[str] = field(default_factory=set)


def ran(work: Work, preload: Sequence[Path]) -> Ending:
    """Do the work in a child, until its end or its first bad input."""
    status, _, words = ended(
        "benchmarks.fuzz.child",
        environment=OPTIONS | {"LD_PRELOAD": " ".join(map(str, preload))},
        most_s=MOST_WALL_S,
        sent=pickle.dumps(work),
    )
    number = int(work.progress.read_bytes() or work.numbers.start)
    if status == 0:
        return Ending(number)
    if status in (-signal.SIGPROF, None):
        return Ending(number, f"took more than {work.most_s:.0f} s\n{words}")
    return Ending(number, words or f"ended by signal {-status}")


def fuzzed(work: Work, preload: Sequence[Path], folder: Path, most_s: float) -> Found:
    """Do the work in as many children as there are cores; bad inputs go to `folder`."""
    found, lock, end = Found(), threading.Lock(), time.monotonic() + most_s

    def batch(first: int) -> None:
        part = replace(work, progress=folder / f"progress-{first}")
        numbers = work.numbers[first : first + BATCH]
        while numbers and found.bad < MOST_BAD and time.monotonic() < end:
            part.progress.write_bytes(b"")
            ending = ran(replace(part, numbers=numbers), preload)
            with lock:
                found.inputs += ending.number + 1 - numbers.start
                if ending.is_bad:
                    _keep(work, ending, folder, found)
            numbers = range(ending.number + 1, numbers.stop)
        part.progress.unlink(missing_ok=True)

    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        list(pool.map(batch, range(0, len(work.numbers), BATCH)))
    return found


def _keep(work: Work, ending: Ending, folder: Path, found: Found) -> None:
    """Write a bad input, and what is said of it, if it is the first of its place."""
    found.bad += 1
    if ending.place in found.places:
        return
    found.places.add(ending.place)
    corpus = pickle.loads(work.corpus.read_bytes())
    calls = drawn(work.kernels, corpus, work.seed, ending.number)
    file = folder / f"{calls[-1][0].name}-{work.seed}-{ending.number}.pickle"
    one = replace(work, numbers=range(ending.number, ending.number + 1), calls=calls)
    file.write_bytes(pickle.dumps(one))
    file.with_suffix(".txt").write_text(ending.report)
    print(f"{file}: {ending.place}", flush=True)
