"""Wrong inputs of every kind that the field reported, drawn by number alone and given to the
program as a user would: what it says of each."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from support.wrong_inputs import KINDS, Case, fault

_PROGRAM = (sys.executable, "-c", "from trigpoint.cli import main; main()")
_DRAWN, _SHOWN = 6, 300
SEEN = '{"faces": [{"face": 0}]}\n{"faces": []}\n'


@pytest.mark.parametrize(
    ("status", "out", "err", "expected"),
    [
        (0, SEEN, "left out: 1 picture, b.png", ""),
        (2, SEEN, "left out: 1 picture, b.png", "status 2, not 0"),
        (0, SEEN, "1 picture", "nothing like «left out»"),
        (0, SEEN, "left out: face 3", "«face 3»"),
        (0, "", "left out", "faces in 0 pictures of 1"),
        (1, "", "Traceback (most recent call last):", "a traceback"),
    ],
)
def test_an_answer_is_right_in_status_words_and_what_is_used(
    status: int, out: str, err: str, expected: str
) -> None:
    case = Case(("detect",), (0,), says=("left out",), never=(r"face \d",), seen=1)
    assert fault(case, status, out, err) == expected


@pytest.mark.parametrize("kind", KINDS)
def test_a_wrong_input_is_the_same_for_the_same_number(kind: str, tmp_path: Path) -> None:
    drawn = []
    for name in ("a", "b"):
        folder = tmp_path / name
        folder.mkdir()
        case = KINDS[kind](folder, np.random.default_rng(5))
        with case.beside:
            pass  # a board's port is closed behind it
        words = [str(word).replace(str(folder), "") for word in case.words]
        drawn.append((words, case.statuses, case.says, case.never, case.seen))
    assert drawn[0] == drawn[1]
    assert any((tmp_path / "a").iterdir())


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_a_wrong_input_is_said_with_cause_and_remedy_and_the_rest_is_used(
    kind: str, tmp_path: Path
) -> None:
    faults = []
    for number in range(_DRAWN):
        folder = tmp_path / str(number)
        folder.mkdir()
        case = KINDS[kind](folder, np.random.default_rng((33, list(KINDS).index(kind), number)))
        words = [*_PROGRAM, *map(str, case.words)]
        with case.beside:
            done = subprocess.run(words, capture_output=True, text=True, timeout=120, check=False)
        if found := fault(case, done.returncode, done.stdout, done.stderr):
            faults.append(f"{found}: {' '.join((done.stderr or done.stdout).split())[-_SHOWN:]}")
    assert not faults, "\n".join(faults)
