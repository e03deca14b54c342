"""What may be wrong with a target file of which nothing is found: tries similar targets."""

import time
from collections.abc import Callable, Iterator, Sequence

import cv2
import msgspec
import numpy as np

from trigpoint.edge.detector import detector_for
from trigpoint.target import Face, Pattern, Target

LEAST_PICTURES = 10
_TRIED = 4
"""This many pictures, spread over all, show a board that is in most of them."""
_LONGEST_S = 20.0


class Hints:
    """Keeps a few of the pictures in which nothing was found."""

    def __init__(self, target: Target) -> None:
        self._target = target
        self._kept: list[np.ndarray] = []
        self._every, self._count = 1, 0

    def keep(self, picture: np.ndarray) -> None:
        """Take one more picture in which nothing was found."""
        if self._count % self._every == 0:
            self._kept.append(picture)
            if len(self._kept) == 2 * _TRIED:
                self._kept, self._every = self._kept[::2], 2 * self._every
        self._count += 1

    def text(self) -> str:
        """One line of what to do."""
        found = self._found()
        if found:
            return f"the pictures show the board with {found}; correct the target file"
        return (
            "no board near to the target file's is in them either; compare its columns, rows and "
            "dictionary with the print, and see that the board is sharp, whole, and large enough"
        )

    def _found(self) -> str:
        until_s = time.monotonic() + _LONGEST_S
        for words, target in variants(self._target):
            detector = detector_for([target])
            for picture in self._kept[:_TRIED]:
                if time.monotonic() > until_s:
                    return ""
                if detector.detect(picture):
                    return words
        return ""


def variants(target: Target) -> Iterator[tuple[str, Target]]:
    """(difference, target) for targets that people may mean when they write this one."""
    faces = target.faces
    if any(face.pattern is not Pattern.APRILGRID for face in faces):
        yield "inverted exchanged", _changed(target, lambda f: {"inverted": not f.inverted})
    if any(face.pattern is Pattern.CHARUCO for face in faces):
        yield "legacy exchanged", _changed(target, lambda f: {"legacy": not f.legacy})
    yield (
        "columns and rows exchanged",
        _changed(target, lambda f: {"columns": f.rows, "rows": f.columns}),
    )
    if any(face.pattern is Pattern.CHECKERBOARD for face in faces):
        more = "columns and rows one more: they count squares, not inner corners"
        yield more, _changed(target, lambda f: {"columns": f.columns + 1, "rows": f.rows + 1})
    for name in _other_dictionaries(faces):
        yield f'dictionary = "{name}"', _changed(target, lambda _, n=name: {"dictionary": n})


def _changed(target: Target, change: Callable[[Face], dict[str, object]]) -> Target:
    """The target with each face changed; unchanged if the result would be invalid."""
    faces = []
    for face in target.faces:
        try:
            changed = msgspec.structs.replace(face, **_fitting(face, change(face)))
            changed.__post_init__()
        except ValueError:
            changed = face
        faces.append(changed)
    try:
        return Target(target.name, tuple(faces))
    except ValueError:
        return target


def _fitting(face: Face, changes: dict[str, object]) -> dict[str, object]:
    """The changes that apply to a face's pattern."""
    known = {
        Pattern.CHECKERBOARD: {"columns", "rows", "inverted"},
        Pattern.CHARUCO: {"columns", "rows", "inverted", "legacy", "dictionary"},
        Pattern.APRILGRID: {"columns", "rows", "dictionary"},
    }[face.pattern]
    return {name: value for name, value in changes.items() if name in known}


def _other_dictionaries(faces: Sequence[Face]) -> list[str]:
    """The largest dictionary of each kind, which includes the smaller ones."""
    used = {face.dictionary for face in faces}
    if used == {None}:
        return []
    kinds: dict[str, str] = {}
    for name in dir(cv2.aruco):
        if name.startswith("DICT_"):
            kind = name.rpartition("_")[0] if name[-1].isdigit() and "X" in name else name
            kinds[kind] = max(kinds.get(kind, ""), name, key=lambda n: (len(n), n))
    return [name for name in kinds.values() if name not in used]
