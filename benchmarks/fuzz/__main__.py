"""`make fuzz`: every kernel of the compiled core under a million drawn inputs.

    python -m benchmarks.fuzz [--count 1000000] [--seed 1] [--seconds 0] [FILE]

The core is built for it with the address and undefined-behaviour sanitizers. An input that ends the
program, or that takes too long, is written to out/fuzz with what the sanitizer says; FILE makes one
such input again. Status 1 where there is any.
"""

import argparse
import pickle
import sys
import time
from dataclasses import replace
from pathlib import Path

from trigpoint.native import build
from trigpoint.native.library import LIBRARY

from .child import Work
from .kernels import all_kernels
from .runner import fuzzed, ran

FOLDER = Path("out/fuzz")


def main() -> int:
    """The command line; its exit status."""
    parser = argparse.ArgumentParser(description="Fuzzes the compiled core.")
    parser.add_argument("file", nargs="?", type=Path, help="make this input again")
    parser.add_argument("--count", type=int, default=1_000_000, help="inputs over all kernels")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=0, help="end after so long (0: never)")
    parser.add_argument("--plain", action="store_true", help="without the sanitizers")
    chosen = parser.parse_args()
    try:
        core = LIBRARY if chosen.plain else build.built(sanitize=True, library=build.SANITIZED)
        preload = () if chosen.plain else build.sanitizers()
    except build.BuildError as error:
        print(f"fuzz: {error}", file=sys.stderr)
        return 2
    FOLDER.mkdir(parents=True, exist_ok=True)
    if chosen.file:
        again: Work = pickle.loads(chosen.file.read_bytes())
        ending = ran(replace(again, core=str(core), progress=FOLDER / "progress"), preload)
        print(ending.report or "nothing was found")
        return int(ending.is_bad)
    kernels = all_kernels()
    work = Work(str(core), kernels, chosen.seed, range(chosen.count), FOLDER / "progress")
    begun = time.monotonic()
    found = fuzzed(work, preload, FOLDER, chosen.seconds or float("inf"))
    took = time.monotonic() - begun
    print(
        f"{found.inputs} inputs to {len(kernels)} kernels in {took:.0f} s "
        f"({found.inputs / took:.0f} a second): {len(found.places)} found, {found.bad} times"
    )
    return int(found.bad > 0)


if __name__ == "__main__":
    sys.exit(main())
