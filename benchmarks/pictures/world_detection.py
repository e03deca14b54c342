"""Our detectors against OpenCV's on pictures of boards as the world shows them (`world_views`), one
thread each: faces found, corners found of those found, corners against the truth."""

from functools import partial

from benchmarks.table import Row, share_of

from .detection import OURS, one_thread, opencv_finders, our_finder, runs
from .scoring import Found, score_of, score_rows, sigma_row
from .views import View
from .world_views import FACES, KINDS, target_of, world_views

_VIEWS = 24
_row = partial(Row, "world")


def run(effort: float = 1.0) -> list[Row]:
    """Both patterns, every kind of picture."""
    count = share_of(_VIEWS, effort, least=2)
    with one_thread():
        return [row for choice in FACES for kind in KINDS for row in _rows(choice, kind, count)]


def _rows(choice: str, kind: str, count: int) -> list[Row]:
    """Recall and accuracy beside each of OpenCV's ways; a sigma beside a true one."""
    views, target = world_views(choice, kind, count), target_of(choice)
    others = opencv_finders(target, choice)
    done = runs({OURS: our_finder(target)} | others, views)
    scores = {name: score_of(views, run.answers) for name, run in done.items()}
    ours, what, rows = scores[OURS], f"{choice}, {kind}", []
    share = 100 * _corner_share(views, done[OURS].answers)
    rows.append(_row(f"{what}, corners found", "%", share, 100.0, "all", more_is_better=True))
    for name in others:
        rows += score_rows(_row, what, ours, scores[name], name)
        took = (done[OURS].milliseconds, done[name].milliseconds)
        rows.append(_row(f"{what}, first search", "ms", *took, name))
    return [*rows, sigma_row(_row, what, ours)]


def _corner_share(views: list[View], answers: list[list[Found]]) -> float:
    """Of all corners of the faces, how many are found."""
    all_of_them = sum(true.face.corner_count for view in views for true in view.faces)
    return sum(len(found.corners) for answer in answers for found in answer) / all_of_them
