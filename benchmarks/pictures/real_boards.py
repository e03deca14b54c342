"""`python -m benchmarks real_boards`: first searches of real pictures, and of real and busy ones
without a board, beside the finders of OpenCV, calib-targets and AprilTag: the median of
milliseconds, and how many boards are found whole. Then what follows a first search."""

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer
from apriltag import apriltag  # pyright: ignore[reportMissingImports] - of the extra `bench`
from calib_targets import (  # pyright: ignore[reportMissingImports] - of the extra `bench`
    CharucoBoardSpec,
    CharucoParams,
    ChessboardParams,
    MarkerLayout,
    ScanDecodeConfig,
    detect_charuco,
    detect_chessboard,
)

from benchmarks.table import Row
from benchmarks.timing import in_new_process, worked
from trigpoint.contract.messages import FaceSighting
from trigpoint.edge.detector import detector_for
from trigpoint.site.target import Face, Pattern, Target

from .detection import OURS, Run, followed, runs
from .empty import empty_pictures
from .opencv_finders import charuco_shared, checkerboards, checkerboards_by_sectors
from .real_sets import SETS, PictureSet, backgrounds
from .scoring import Finder, found_as
from .views import View, gallery

_row = partial(Row, "real_boards")
CLASSIC, SECTORS = "classic + sub-pixel", "sector finder, exhaustive"
_SIZE = (640, 480)
_BUSY = 40
_FOLLOWED, _LENGTH = 6, 8
_APART_NS = 30_000_000


def main(
    data: Annotated[Path, typer.Option(help="The folder with the sets.")] = Path("../shared/data"),
) -> list[Row]:
    """First searches of real pictures, and what follows them, beside other finders."""
    rows = [row for pictured in SETS for row in _set_rows(pictured, data)]
    rows += _empty_rows()
    rows += [_followed_row(choice) for choice in ("charuco", "checkerboard")]
    return rows + _start_rows(data)


def _set_rows(pictured: PictureSet, data: Path) -> list[Row]:
    face = pictured.face
    views = [View(picture, ()) for picture in pictured.pictures(data)]
    if not views:
        return []
    others = _others(face)
    done = runs({OURS: _ours(face), **others}, views)
    whole = {name: _found_whole(face, run) for name, run in done.items()}
    rows = [_time_row(f"{pictured.name}: first search", done, name) for name in others]
    what = f"{pictured.name}: found whole, of {len(views)}"
    rows += [
        _row(what, "boards", len(whole[OURS]), len(whole[name]), name, more_is_better=True)
        for name in others
    ]
    union = set[int]().union(*(whole[name] for name in others))
    return [*rows, _row(what, "boards", len(whole[OURS]), len(union), "any", more_is_better=True)]


def _empty_rows() -> list[Row]:
    """Photographs, and drawn pictures of all that looks like a board, without one: in most of them
    boards are no longer looked for that the target file may mean."""
    kinds = {
        "photographs": [cv2.resize(picture, _SIZE) for picture in backgrounds()],
        "busy, drawn": list(empty_pictures(_BUSY)),
    }
    rows = []
    for pattern in (Pattern.CHECKERBOARD, Pattern.CHARUCO):
        face = next(pictured.face for pictured in SETS if pictured.face.pattern is pattern)
        other, find = next(iter(_others(face).items()))
        for kind, pictures in kinds.items():
            finders = {OURS: _ours(face), other: find}
            done = runs(finders, [View(picture, ()) for picture in pictures])
            rows.append(_time_row(f"no {pattern.value}, 640 x 480, {kind}", done, other))
    return rows


def _followed_row(choice: str) -> Row:
    """Two faces of the lab's target, followed through their drive; pictures come so fast that none
    of them is searched for others."""
    pictures, took = gallery(choice), list[float]()
    for sequence in pictures.sequences(_FOLLOWED, _LENGTH):
        quick = [(1 + number * _APART_NS, view) for number, (_, view) in enumerate(sequence)]
        seen = followed(pictures.target, quick)
        took += [1e3 * seconds for _, seconds, found in seen if len(found) == 2]
    return _row(f"two faces followed, {choice}, 640 x 480", "ms", _median(took), 1.0, "the goal")


def _start_rows(data: Path) -> list[Row]:
    """The first picture that a process searches, and the next, in processes of their own."""
    chosen = {pictured.face.pattern: pictured for pictured in reversed(SETS)}
    rows = []
    for pattern, pictured in chosen.items():
        picture = next(pictured.pictures(data), None)
        if picture is None:
            continue
        first, following = in_new_process(_first_two, pictured.face, picture)
        what = f"first picture after the start, {pattern.value}"
        rows.append(_row(what, "ms", 1e3 * first, 1e3 * following, "the next"))
    return rows


def _first_two(face: Face, picture: np.ndarray) -> tuple[float, float]:
    find = _ours(face)
    return worked(lambda: find(picture))[0], worked(lambda: find(picture))[0]


def _others(face: Face) -> dict[str, Finder]:
    """Other libraries' finders, each in its fastest fair form."""
    found: dict[str, Finder]
    if face.pattern is Pattern.CHARUCO:
        found = {"OpenCV's markers": charuco_shared([face]), "calib-targets": _charuco(face)}
    elif face.pattern is Pattern.APRILGRID:
        found = {"AprilTag": _tags(face)}
    else:
        found = {
            CLASSIC: checkerboards([face]),
            SECTORS: checkerboards_by_sectors([face]),
            "calib-targets": _chessboard(face),
        }
    if not face.inverted:
        return found
    return {n: lambda picture, f=f: f(cv2.bitwise_not(picture)) for n, f in found.items()}


def _chessboard(face: Face) -> Finder:
    """The first one of calib-targets, which is not told how many squares there are."""
    params = ChessboardParams(max_components=1)

    def find(picture: np.ndarray) -> list[FaceSighting]:
        board = detect_chessboard(picture, params=params)
        return _found(face, (corner.position for corner in board.corners) if board else ())

    return find


def _charuco(face: Face) -> Finder:
    """That of calib-targets."""
    share = (face.marker or 0.0) / face.square
    board = CharucoBoardSpec(
        rows=face.rows,
        cols=face.columns,
        cell_size=face.square,
        marker_size_rel=share,
        dictionary=face.dictionary,
        marker_layout=MarkerLayout.OPENCV_CHARUCO,
    )
    params = CharucoParams(board, scan=ScanDecodeConfig(marker_size_rel=share))

    def find(picture: np.ndarray) -> list[FaceSighting]:
        try:
            seen = detect_charuco(picture, params=params)
        except RuntimeError:  # that is how it says that there is none
            return []
        return _found(face, (corner.position for corner in seen.corners))

    return find


def _tags(face: Face) -> Finder:
    """Tags of the family 36h11 by AprilTag 3, which looks for edges at half the size, as it does
    where nothing else is said."""
    detector = apriltag("tag36h11", decimate=2.0)

    def find(picture: np.ndarray) -> list[FaceSighting]:
        tags = detector.detect(picture)
        return _found(face, (corner for tag in tags for corner in tag["lb-rb-rt-lt"]))

    return find


def _found(face: Face, pixels: Iterable[object]) -> list[FaceSighting]:
    seen = np.array(list(pixels), float).reshape(-1, 2)
    return [found_as(face.id, np.arange(len(seen)), seen)] if len(seen) else []


def _found_whole(face: Face, run: Run) -> set[int]:
    """In which pictures all corners of a board were found."""
    return {
        number
        for number, answer in enumerate(run.answers)
        if any(len(found.corners) == face.corner_count for found in answer)
    }


def _ours(face: Face) -> Finder:
    return detector_for([Target("board", (face,))]).detect


def _time_row(what: str, done: Mapping[str, Run], other: str) -> Row:
    ours, theirs = (1e3 * _median(done[name].seconds) for name in (OURS, other))
    return _row(what, "ms", ours, theirs, other)


def _median(values: Sequence[float]) -> float:
    return float(np.median(values)) if values else np.nan
