"""`make fuzz`: every kernel of the compiled core under a million drawn inputs.

    python -m benchmarks fuzz [--count 1000000] [--seed 1] [--seconds 0] [FILE]

An input is calls of the core as work on drawn pictures and sessions makes them, spoilt. The core is
built for it with the address and undefined-behaviour sanitizers. An input that ends the
program, or that takes too long, is written to out/fuzz with what the sanitizer says; FILE makes one
such input again. Status 1 where there is any.
"""

import os
import pickle
import re
import signal
import sys
import threading
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated

import typer
from msgspec import Struct, field
from msgspec.structs import replace

from benchmarks.timing import ended, in_new_process
from trigpoint.native import build

from .child import Work
from .corpus import all_kernels, worked
from .inputs import drawn

FOLDER = Path("out/fuzz")
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


def main(
    file: Annotated[Path | None, typer.Argument(help="Make this input again.")] = None,
    count: Annotated[int, typer.Option(help="Inputs over all kernels.", min=1)] = 1_000_000,
    seed: Annotated[int, typer.Option(help="Draws them.")] = 1,
    seconds: Annotated[float, typer.Option(help="End after so long; 0: never.")] = 0.0,
) -> None:
    """Every kernel of the compiled core under drawn inputs."""
    try:
        core = build.built(sanitize=True, library=build.SANITIZED)
        preload = build.sanitizers()
    except build.BuildError as error:
        print(f"fuzz: {error}", file=sys.stderr)
        raise typer.Exit(2) from None
    FOLDER.mkdir(parents=True, exist_ok=True)
    if file:
        again: Work = pickle.loads(file.read_bytes())
        ending = ran(replace(again, core=str(core), progress=FOLDER / "progress"), preload)
        print(ending.report or "nothing was found")
        raise typer.Exit(int(ending.is_bad))
    kernels, corpus = all_kernels(), FOLDER / "corpus"
    corpus.write_bytes(pickle.dumps(in_new_process(worked, seed)))
    work = Work(str(core), kernels, corpus, seed, range(count), FOLDER / "progress")
    begun = time.monotonic()
    found = fuzzed(work, preload, FOLDER, seconds or float("inf"))
    took = time.monotonic() - begun
    print(
        f"{found.inputs} inputs to {len(kernels)} kernels in {took:.0f} s "
        f"({found.inputs / took:.0f} a second): {len(found.places)} found, {found.bad} times"
    )
    raise typer.Exit(int(found.bad > 0))
