"""Our detectors against OpenCV's on the same rendered pictures, one thread each.

Milliseconds a picture, faces found, corners against the projected truth.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

import cv2
import numpy as np

from trigpoint.edge.detector import detector_for
from trigpoint.target import Target

from .opencv_finders import (
    Finder,
    charuco_each,
    charuco_shared,
    checkerboards,
    checkerboards_in_even_light,
)
from .scoring import Found, Score, score_of
from .table import Row, share_of
from .timing import worked
from .views import View, gallery

OURS = "ours"
_WITH_FACES, _EMPTY = 36, 12
_ROUNDS = 2


@dataclass(slots=True)
class Run:
    """What one finder did over some views: seconds for each picture, and what it found."""

    seconds: list[float] = field(default_factory=list)
    answers: list[list[Found]] = field(default_factory=list)

    @property
    def milliseconds(self) -> float:
        """A picture, on average."""
        return 1e3 * float(np.mean(self.seconds))


def run(effort: float = 1.0) -> list[Row]:
    """Both kinds of target."""
    with one_thread():
        return [row for target in ("charuco", "checkerboard") for row in _rows(target, effort)]


def our_finder(target: Target) -> Finder:
    """Our detector in the shape of OpenCV's finders."""
    detector = detector_for([target])

    def find(picture: np.ndarray) -> list[Found]:
        return [Found(s.face, s.corners, s.pixels) for s in detector.detect(picture)]

    return find


def opencv_finders(target: Target, choice: str) -> dict[str, Finder]:
    """OpenCV's ways to find the faces of a target, by what the table calls them."""
    faces = target.faces
    if choice == "charuco":
        return {
            "CharucoDetector, one a face": charuco_each(faces),
            "CharucoDetector, markers once": charuco_shared(faces),
        }
    return {
        "findChessboardCorners": checkerboards(faces),
        "findChessboardCorners, flags=0": checkerboards_in_even_light(faces),
    }


def runs(finders: Mapping[str, Finder], views: list[View]) -> dict[str, Run]:
    """Each finder over the views; a picture's time is the best of some turns."""
    done = {name: Run() for name in finders}
    for view in views:
        turns = [
            {name: worked(lambda f=find, v=view: f(v.picture)) for name, find in finders.items()}
            for _ in range(_ROUNDS)
        ]
        for name in finders:
            done[name].seconds.append(min(turn[name][0] for turn in turns))
            done[name].answers.append(turns[0][name][1])
    return done


@contextmanager
def one_thread() -> Iterator[None]:
    """OpenCV keeps to the calling thread."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def _rows(choice: str, effort: float) -> list[Row]:
    """Times beside each of OpenCV's ways; what was found, where those differ in it."""
    pictures = gallery(choice)
    others = opencv_finders(pictures.target, choice)
    finders = {OURS: our_finder(pictures.target)} | others
    full = pictures.with_faces(share_of(_WITH_FACES, effort))
    empty = pictures.without_faces(share_of(_EMPTY, effort))
    on_full, on_empty = runs(finders, full), runs(finders, empty)
    scores = {
        name: score_of(full + empty, on_full[name].answers + on_empty[name].answers)
        for name in finders
    }
    rows = []
    for name in others:
        for where, on in (("with faces", on_full), ("empty", on_empty)):
            took = (on[OURS].milliseconds, on[name].milliseconds)
            rows.append(_row(f"{choice}, a picture {where}", "ms", *took, name))
    first, *rest = others
    for name in (first, *(n for n in rest if scores[n].errors != scores[first].errors)):
        rows += _score_rows(choice, scores[OURS], scores[name], name)
    return rows


def _score_rows(choice: str, ours: Score, other: Score, name: str) -> list[Row]:
    both = ours.errors.keys() & other.errors.keys()
    shares = (100 * ours.share, 100 * other.share)
    return [
        _row(f"{choice}, faces found", "%", *shares, name, more_is_better=True),
        _row(f"{choice}, faces found where none is", "faces", ours.wrong, other.wrong, name),
        _row(f"{choice}, corner error, all that it found", "px", ours.rms(), other.rms(), name),
        _row(f"{choice}, corner error, found by both", "px", ours.rms(both), other.rms(both), name),
    ]


def _row(
    what: str, unit: str, ours: float, other: float, name: str, *, more_is_better: bool = False
) -> Row:
    return Row("detection", what, unit, ours, other, name, more_is_better)
