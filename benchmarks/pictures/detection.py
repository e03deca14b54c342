"""Our detectors against OpenCV's on the same rendered pictures, one thread each.

Milliseconds a picture, faces found, corners against the projected truth.
"""

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
from msgspec import Struct, field

from benchmarks.table import Row, share_of
from benchmarks.timing import WorkClock, best_of, worked
from trigpoint.contract.messages import FaceSighting
from trigpoint.edge.detector import detector_for
from trigpoint.edge.tracker import TargetTracker
from trigpoint.site.target import Target
from trigpoint.tools.simulation.sight.seen_corners import smallest_square

from .nasty import nasty_pictures
from .opencv_finders import (
    charuco_each,
    charuco_shared,
    checkerboards,
    checkerboards_by_sectors,
)
from .scoring import Finder, score_of, score_rows, sigma_row
from .views import Gallery, View, gallery

OURS = "ours"
_row = partial(Row, "detection")
# Pictures with faces and without, by size; the larger cost OpenCV half a second each.
_SIZES: dict[str, tuple[int, int] | None] = {"640 x 480": None, "1280 x 720": (1280, 720)}
_WITH_FACES, _EMPTY = {"640 x 480": 12, "1280 x 720": 4}, 4
_SEQUENCES, _LENGTH = {"640 x 480": 5, "1280 x 720": 2}, 6
# A followed face has been seen twice.
_SETTLED = 2
_ROUNDS = 2
# Of pictures over which a search could take forever.
_PERIOD_S = 0.1


class Run(Struct):
    """What one finder did over some views: seconds for each picture, and what it found."""

    seconds: list[float] = field(default_factory=list)
    answers: list[Sequence[FaceSighting]] = field(default_factory=list)

    @property
    def milliseconds(self) -> float:
        """A picture, on average."""
        return 1e3 * float(np.mean(self.seconds))


def run(effort: float = 1.0) -> list[Row]:
    """Both kinds of target, at both sizes, driving: at rest all came out the same."""
    choices = ("charuco", "checkerboard")
    rows = [row for target in choices for size in _SIZES for row in _rows(target, size, effort)]
    return rows + [_worst_row(target) for target in choices]


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
        "findChessboardCorners, flags=0": checkerboards(faces, 0),
        "findChessboardCornersSB, exhaustive": checkerboards_by_sectors(faces),
    }


def runs(finders: Mapping[str, Finder], views: list[View]) -> dict[str, Run]:
    """Each finder over the views; a picture's time is the best of some turns."""
    done = {name: Run() for name in finders}
    for view in views:
        best = best_of(_ROUNDS, {n: partial(find, view.picture) for n, find in finders.items()})
        for name, (took, answer) in best.items():
            done[name].seconds.append(took)
            done[name].answers.append(answer)
    return done


def _rows(choice: str, size: str, effort: float) -> list[Row]:
    """Times beside each of OpenCV's ways; what was found and how well, near and far."""
    driving = gallery(choice, size=_SIZES[size])
    others = opencv_finders(driving.target, choice)
    finders = {OURS: detector_for([driving.target]).detect} | others
    what = f"{choice} {size}"
    empty = driving.without_faces(share_of(_EMPTY, effort))
    rows = _time_rows(f"{what}, empty picture", runs(finders, empty), others)
    count = share_of(_WITH_FACES[size], effort, least=2)
    views = sorted(driving.with_faces(count), key=_spacing)
    done = runs(finders, views)
    rows += _time_rows(f"{what} driving, first search", done, others)
    half = len(views) // 2
    for part, which in (("far", slice(None, half)), ("near", slice(half, None))):
        scores = {n: score_of(views[which], run.answers[which]) for n, run in done.items()}
        first, *rest = others
        for other in (first, *(n for n in rest if scores[n].errors != scores[first].errors)):
            rows += score_rows(_row, f"{what} driving, {part}", scores[OURS], scores[other], other)
    rows.append(sigma_row(_row, f"{what} driving", score_of(views, done[OURS].answers)))
    return rows + _tracked_rows(what, driving, others, size, effort)


def _tracked_rows(
    what: str, pictures: Gallery, others: Mapping[str, Finder], size: str, effort: float
) -> list[Row]:
    """Pictures in which a face was found in the last one, and OpenCV on the same ones."""
    ours, views = Run(), []
    for sequence in pictures.sequences(share_of(_SEQUENCES[size], effort), _LENGTH):
        turns = [followed(pictures.target, sequence) for _ in range(_ROUNDS)]
        for pictured in zip(*turns, strict=True):
            view, _, answer = pictured[0]
            views.append(view)
            ours.seconds.append(min(took for _, took, _ in pictured))
            ours.answers.append(answer)
    if not views:
        return []
    done = {OURS: ours, **runs(others, views)}
    rows = _time_rows(f"{what} driving, found in the last picture", done, others)
    scores = {name: score_of(views, run.answers) for name, run in done.items()}
    first = next(iter(others))
    rows += score_rows(_row, f"{what} driving, followed", scores[OURS], scores[first], first)
    return [*rows, sigma_row(_row, f"{what} driving, followed", scores[OURS])]


def followed(
    target: Target, sequence: list[tuple[int, View]]
) -> list[tuple[View, float, Sequence[FaceSighting]]]:
    """The views of a sequence in which faces were followed, each with its seconds and what a new
    tracker found; the same ones every time."""
    tracker, was_found, followed = TargetTracker([target]), 0, []
    for stamp_ns, view in sequence:
        took, found = worked(lambda v=view, s=stamp_ns: tracker.detect(v.picture, s))
        if was_found >= _SETTLED:
            followed.append((view, took, found))
        was_found = was_found + 1 if found else 0
    return followed


def _worst_row(choice: str) -> Row:
    """The longest that a tracker takes over a nasty picture, first seen and again, within a frame's
    period at 10 Hz; its clock counts its own work."""
    target, worst = gallery(choice).target, 0.0
    for _, picture in nasty_pictures(target.faces[:1]):
        tracker = TargetTracker([target], budget_s=_PERIOD_S, clock=WorkClock())
        for stamp_ns in (100_000_000, 200_000_000):
            took, _ = worked(lambda t=tracker, p=picture, s=stamp_ns: t.detect(p, s))
            worst = max(worst, took)
    return _row(
        f"{choice} 640 x 480, the nastiest picture",
        "ms",
        1e3 * worst,
        1e3 * _PERIOD_S,
        "the period",
    )


def _time_rows(what: str, done: Mapping[str, Run], others: Mapping[str, Finder]) -> list[Row]:
    took = {name: run.milliseconds for name, run in done.items()}
    return [_row(what, "ms", took[OURS], took[name], name) for name in others]


def _spacing(view: View) -> float:
    """The shortest distance of neighbouring corners of the largest face, pixels."""
    whole = (smallest_square(true.face, true.pixels) for true in view.faces if true.is_whole)
    return max(whole, default=0.0)
