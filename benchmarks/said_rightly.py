"""Wrong inputs of every kind, drawn: how many are said rightly, and the rest used.

    python -m benchmarks said_rightly

Each goes to the program as a user would give it. Right is: the status of the contract, the cause
and the remedy in words, no traceback, and the rest used. What was said instead is printed.
"""

import os
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import typer

from .table import Row, share_of
from .wrong_inputs import KINDS, fault

INPUTS, SEED = 200, 33
_PATIENCE_S = 120.0
_SHOWN = 300
_PROGRAM = (sys.executable, "-c", "from trigpoint.cli import main; main()")


@dataclass(frozen=True, slots=True)
class Answer:
    """What came of one input; `fault`: what is wrong about it, empty where nothing is; `said`: the
    end of its output, on one line."""

    kind: str
    fault: str
    said: str


def run(effort: float = 1.0) -> list[Row]:
    """Ask for all inputs, as many at a time as there are cores."""
    numbers = range(share_of(INPUTS, effort, least=len(KINDS)))
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        answers = sorted(pool.map(answer, numbers), key=lambda one: list(KINDS).index(one.kind))
    for kind, group in groupby(answers, key=lambda one: one.kind):
        if wrong := [one for one in group if one.fault]:
            typer.echo(f"{kind}: {wrong[0].fault}: {wrong[0].said}", err=True)
    return list(_rows(answers))


def answer(number: int) -> Answer:
    """Draw the input of a number, give it to the program and judge what it says."""
    kind = list(KINDS)[number % len(KINDS)]
    with TemporaryDirectory() as folder:
        case = KINDS[kind](Path(folder), np.random.default_rng((SEED, number)))
        words = [*_PROGRAM, *map(str, case.words)]
        with case.beside:
            try:
                done = subprocess.run(
                    words, capture_output=True, text=True, timeout=_PATIENCE_S, check=False
                )
            except subprocess.TimeoutExpired:
                return Answer(kind, f"no end in {_PATIENCE_S:.0f} s", "")
    said = " ".join((done.stderr or done.stdout).replace(f"{folder}/", "").split())
    return Answer(kind, fault(case, done.returncode, done.stdout, done.stderr), said[-_SHOWN:])


def _rows(answers: list[Answer]) -> Iterator[Row]:
    for kind in KINDS:
        yield _row(kind, [one for one in answers if one.kind == kind])
    yield _row("all kinds", answers)
    tracebacks = sum("traceback" in one.fault for one in answers)
    yield Row("said rightly", "tracebacks", "inputs", tracebacks, 0, "none")


def _row(what: str, answers: list[Answer]) -> Row:
    right = sum(not one.fault for one in answers)
    return Row("said rightly", what, "inputs", right, len(answers), "all", more_is_better=True)
