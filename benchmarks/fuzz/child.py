"""`python -m benchmarks.fuzz.child`: makes the inputs of a `Work` on standard input, one by one.

Imports nothing but numpy and the border, so that it begins quickly under the sanitizers. It ends by
SIGPROF where one input takes too long, and by whatever the core does to it.
"""

import os
import pickle
import signal
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from msgspec import Struct

from trigpoint.native import library
from trigpoint.native.library import Handle, Kernel

from .inputs import Call, Made, drawn


class Work(Struct, frozen=True):
    """Inputs for the core at `core`: those `numbers` of a seed, or the `calls` of one.

    `corpus`: the file with the calls that they are made of. The number of the one in work goes to
    `progress`; each has `most_s` of processor time.
    """

    core: str
    kernels: tuple[Kernel, ...]
    corpus: Path
    seed: int
    numbers: range
    progress: Path
    most_s: float = 60.0
    calls: list[Call] | None = None


def make(calls: Sequence[Call]) -> None:
    """Make an input's calls; that core or border refuse one is as good as an answer."""
    objects: dict[type[Handle], Handle] = {}
    for kernel, values in calls:
        for value in values:
            if isinstance(value, Made) and value.kind not in objects:
                objects[value.kind] = value.kind()
        given = [objects[value.kind] if isinstance(value, Made) else value for value in values]
        with suppress(RuntimeError, MemoryError, TypeError, ValueError):
            kernel(*given)


def main() -> None:
    """Do the work."""
    work: Work = pickle.load(sys.stdin.buffer)
    library.LIBRARY = Path(work.core)
    corpus = {} if work.calls else pickle.loads(work.corpus.read_bytes())
    with work.progress.open("wb", buffering=0) as progress:
        for number in work.numbers:
            os.pwrite(progress.fileno(), b"%20d" % number, 0)
            calls = work.calls or drawn(work.kernels, corpus, work.seed, number)
            signal.setitimer(signal.ITIMER_PROF, work.most_s)
            make(calls)
    signal.setitimer(signal.ITIMER_PROF, 0)


if __name__ == "__main__":
    main()
