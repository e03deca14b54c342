"""Calls of the core as real work makes them: boards are found and followed in drawn pictures, and
drawn sessions worked out, offline and live."""

import importlib
import pickle
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import closing, contextmanager
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch
from weakref import WeakKeyDictionary

import numpy as np

import trigpoint
from benchmarks.compositions.carried import target_of
from benchmarks.compositions.files import write_composition
from benchmarks.compositions.session import composed_session
from benchmarks.pictures.nasty import crowd_of_boards
from benchmarks.study.session import simulated_session
from benchmarks.study.work import calibrated
from trigpoint.edge.tracker import TargetTracker
from trigpoint.fusion.live.solver_process import SolverProcess
from trigpoint.fusion.pipeline import Pipeline
from trigpoint.native.library import Handle, Kernel

from .inputs import Call, Corpus, Made

_PARTS = ("edge", "fusion", "geometry")
_PATTERNS = ("checkerboard", "charuco")
_SESSIONS = ("space", "composition", "everything")
_LIVE = ("alike", "displaced", "time_offset")
_ASK_EVERY = 500
# Of each kernel, and how many calls with the same object are kept before one; of none larger.
_KEPT, _BEFORE = 8, 4
_MOST_BYTES = 2**19


def all_kernels() -> tuple[Kernel, ...]:
    """Of all rooms that have any, by name."""
    found: dict[str, Kernel] = {}
    house = Path(trigpoint.__path__[0])
    for file in (file for part in _PARTS for file in (house / part).rglob("*.py")):
        if " = Kernel(" not in file.read_text():
            continue
        module = ".".join(file.relative_to(house.parent).with_suffix("").parts)
        declared = vars(importlib.import_module(module)).values()
        found |= {value.name: value for value in declared if isinstance(value, Kernel)}
    return tuple(found[name] for name in sorted(found))


def worked(seed: int) -> Corpus:
    """What is called in some work, each call with those before it of the same object."""
    with recorded(np.random.default_rng(seed)) as corpus:
        for pattern, crowd in product(_PATTERNS, (1, 2)):
            found_boards(pattern, crowd)
        for kind in _SESSIONS:
            _calibrated(kind, seed)
        for situation in _LIVE:
            _driven(situation, seed)
    return corpus


@contextmanager
def recorded(random: np.random.Generator) -> Iterator[Corpus]:
    """Some calls of each kernel, drawn from all that are made meanwhile."""
    corpus: Corpus = defaultdict(list)
    counts: dict[str, int] = defaultdict(int)
    before: WeakKeyDictionary[Handle, list[Call]] = WeakKeyDictionary()
    make = Kernel.__call__

    def noted(kernel: Kernel, *values: object) -> int:
        own = next((value for value in values if isinstance(value, Handle)), None)
        if sum(value.nbytes for value in values if isinstance(value, np.ndarray)) > _MOST_BYTES:
            return make(kernel, *values)
        counts[kernel.name] += 1
        kept = corpus[kernel.name]
        place = len(kept) if len(kept) < _KEPT else int(random.integers(counts[kernel.name]))
        if own is not None or place < _KEPT:
            call = (kernel, [_copy(value) for value in values])
            chain = [call] if own is None else [*before.get(own, ()), call]
            if own is not None:
                before[own] = chain[-_BEFORE:]
            if place < _KEPT:
                kept[place : place + 1] = [chain]
        return make(kernel, *values)

    with patch.object(Kernel, "__call__", noted):
        yield corpus


def _copy(value: object) -> object:
    if isinstance(value, Handle):
        return Made(type(value))
    return value.copy() if isinstance(value, np.ndarray) else value


def found_boards(pattern: str, crowd: int) -> None:
    """A board or four, looked for and then followed, in a picture of 320 × 240."""
    target = target_of(pattern, "sheet")
    picture = crowd_of_boards(target.faces[0], 2 * crowd)[:240, :320]
    tracker = TargetTracker([target])
    for number in range(4):
        tracker.detect(np.ascontiguousarray(np.roll(picture, number, axis=1)), number * 10**8)


def _calibrated(kind: str, seed: int) -> None:
    """As a user would, with the page and the places to drive to next."""
    with TemporaryDirectory() as folder:
        calibrated(write_composition(composed_session(kind, seed), Path(folder)))


def _driven(situation: str, seed: int) -> None:
    """A drive with corrections, whose solver is another process, to which odometry is sent."""
    session = simulated_session(situation, seed)
    with closing(SolverProcess(session.inputs.data_set())) as solver:
        pipeline = Pipeline(session.inputs, is_live=False, solver=solver)
        pipeline.resumed(is_new=True)
        for number, (node, message) in enumerate(session.messages):
            pipeline.push(node, message)
            pipeline.advance()
            if number % _ASK_EVERY == 0:
                pipeline.reports.ask()
                while not pipeline.reports.is_answered:
                    time.sleep(0.01)
                    pipeline.advance()
        pickle.loads(pickle.dumps(pipeline.inputs.data_set().tracks))
