"""The core's fuzzer: no kernel falls, and one that does is written down to be made again."""

import pickle
import re
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from benchmarks.fuzz.child import Work
from benchmarks.fuzz.corpus import all_kernels, found_boards, recorded
from benchmarks.fuzz.inputs import VARIANTS
from benchmarks.fuzz.runner import fuzzed, ran
from benchmarks.study.session import simulated_session, worked_out
from trigpoint.native.build import SOURCES
from trigpoint.native.library import LIBRARY, Kernel

TESTS_OWN = {"tp_scatter", "tp_sound_corners"}


def test_every_kernel_is_fuzzed() -> None:
    sources = "".join(path.read_text() for path in SOURCES.rglob("*.cpp"))
    exported = set(re.findall(r"^TRIGPOINT_KERNEL\((\w+)\)", sources, re.MULTILINE))
    assert {kernel.name for kernel in all_kernels()} == exported - TESTS_OWN


def test_no_drawn_input_harms_the_core(tmp_path: Path) -> None:
    with recorded(np.random.default_rng(1)) as calls:
        for pattern in ("checkerboard", "charuco"):
            found_boards(pattern, 1)
        worked_out(simulated_session("one_picture", 1))
    corpus, kernels = tmp_path / "corpus", all_kernels()
    corpus.write_bytes(pickle.dumps(calls))
    count = 2 * VARIANTS * len(kernels)  # every kernel is met twice
    work = Work(str(LIBRARY), kernels, corpus, 1, range(count), tmp_path / "progress")
    found = fuzzed(work, (), tmp_path, float("inf"))
    assert (found.inputs, found.places) == (count, set())


def test_an_input_that_ends_the_program_is_written_down(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    corpus = tmp_path / "corpus"
    corpus.write_bytes(pickle.dumps({}))
    kernels = (Kernel("abort", int),)
    work = Work(str(LIBRARY), kernels, corpus, 1, range(2), tmp_path / "progress")
    found = fuzzed(work, (), tmp_path, float("inf"))
    assert (found.inputs, found.bad) == (2, 2)
    [file] = tmp_path.glob("*.pickle")  # both are one fault
    assert str(file) in capsys.readouterr().out
    again = replace(pickle.loads(file.read_bytes()), progress=tmp_path / "again")
    assert "signal 6" in ran(again, ()).report
