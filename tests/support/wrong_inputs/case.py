"""A wrong input, the command that gets it, and what its output has to be."""

import json
import re
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

import numpy as np
from msgspec import Struct, field

LEFT_OUT = r"left out|(could|can)(not| not) be (read|used|decoded)|passed over|skipped"
LOCATED = r"c1\s+located"


class Case(Struct, frozen=True):
    """`words`: of the command line; `statuses`: those that it may end with; `says` and `never`:
    patterns that its output has and has not; `seen`: in how many pictures it finds faces, of which
    `--json` tells; `beside`: what is there as long as it runs."""

    words: tuple[str | Path, ...]
    statuses: tuple[int, ...] = (0,)
    says: tuple[str, ...] = ()
    never: tuple[str, ...] = ()
    seen: int = 0
    beside: AbstractContextManager[object] = field(default_factory=nullcontext)


Kind = Callable[[Path, np.random.Generator], Case]
"""Writes a wrong input into a folder that is its own."""


def fault(case: Case, status: int, out: str, err: str) -> str:
    """What is not right about an answer; empty where all is."""
    said = out + err
    if "Traceback" in said:
        return "a traceback"
    if status not in case.statuses:
        return f"status {status}, not {' or '.join(map(str, case.statuses))}"
    for pattern in case.says:
        if not _found(pattern, said):
            return f"nothing like «{pattern}»"
    for pattern in case.never:
        if match := _found(pattern, said):
            return f"«{match[0]}»"
    if (seen := _pictures_with_faces(out)) < case.seen:
        return f"faces in {seen} pictures of {case.seen}"
    return ""


def _found(pattern: str, text: str) -> re.Match[str] | None:
    return re.search(pattern, text, re.IGNORECASE | re.DOTALL)


def _pictures_with_faces(out: str) -> int:
    return sum(bool(json.loads(line)["faces"]) for line in out.splitlines() if line[:1] == "{")
