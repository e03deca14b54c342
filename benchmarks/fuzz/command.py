"""`make fuzz`: every kernel of the compiled core under a million drawn inputs.

    python -m benchmarks fuzz [--count 1000000] [--seed 1] [--seconds 0] [FILE]

An input is calls of the core as work on drawn pictures and sessions makes them, spoilt. The core is
built for it with the address and undefined-behaviour sanitizers. An input that ends the
program, or that takes too long, is written to out/fuzz with what the sanitizer says; FILE makes one
such input again. Status 1 where there is any.
"""

import pickle
import sys
import time
from pathlib import Path
from typing import Annotated

import typer
from msgspec.structs import replace

from benchmarks.timing import in_new_process
from trigpoint.native import build

from .child import Work
from .corpus import all_kernels, worked
from .runner import fuzzed, ran

FOLDER = Path("out/fuzz")


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
