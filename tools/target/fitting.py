"""Which board to print: the largest squares for which paper and robot have room.

A camera must see a square from afar, so that large squares come before many.
"""

import math
from collections.abc import Iterator, Sequence

from msgspec import Struct, structs

from trigpoint.base.errors import TargetError
from trigpoint.edge.registration.dictionaries import predefined_dictionary
from trigpoint.site.target import NOWHERE, Face, Numbering, Pattern
from trigpoint.tools.shapes.bodies import print_size

_FEWEST = {Pattern.CHECKERBOARD: 7, Pattern.CHARUCO: 5, Pattern.APRILGRID: 3}
"""Squares (tags) along the shorter side where nobody says how many: those of the paper's board, of
the board that `init` writes, and as many corners with tags."""
_LEAST, _MOST = 3, 40  # along each side; fewer have too few corners for a pose
_STEP_M = 0.0005  # a square's side is a multiple of this, which a ruler shows
_SMALLEST_M = 0.005  # of a square that is chosen: a smaller one is seen from arm's length only
_EQUAL_M = 1e-9
_MARKER_SHARE = {Pattern.CHARUCO: 0.75, Pattern.APRILGRID: 1 / 1.3}
"""A marker's part of its square; of an AprilGrid as Kalibr's «tagSpacing = 0.3»."""
_DICTIONARIES = {
    Pattern.CHARUCO: ("DICT_4X4_50", "DICT_4X4_100", "DICT_4X4_250", "DICT_4X4_1000"),
    Pattern.APRILGRID: ("DICT_APRILTAG_36h11",),
}


class Wish(Struct, frozen=True):
    """What is said of a board; None: to be chosen. `square`: metres, of a grid the pitch."""

    pattern: Pattern = Pattern.CHARUCO
    columns: int | None = None
    rows: int | None = None
    square: float | None = None


def fitted(wish: Wish, rooms: Sequence[tuple[float, float]], *, copies: int) -> Face:
    """The face, in no place yet, that fits into one of the rooms (width, height, metres) and of
    which there can be so many copies, each with its own markers. Raises TargetError."""
    boards = [_of_metres(wish.pattern, *counts) for counts in _counts(wish)]
    sized = [_with_square(board, wish, room) for board in boards for room in rooms]
    fitting = [board for board in sized if board is not None]
    if not fitting:
        raise TargetError(_does_not_fit(wish, rooms))
    # max takes the first of equals: an upright sheet before a lying one.
    best = max(fitting, key=lambda board: (board.square, board.corner_count))
    return _with_markers(best, copies)


def _counts(wish: Wish) -> Iterator[tuple[int, int]]:
    """Columns and rows that may be chosen."""
    if wish.columns is not None and wish.rows is not None:
        yield wish.columns, wish.rows
        return
    is_free = wish.columns is None and wish.rows is None and wish.square is None
    for columns in [wish.columns] if wish.columns is not None else range(_LEAST, _MOST + 1):
        for rows in [wish.rows] if wish.rows is not None else range(_LEAST, _MOST + 1):
            is_usual = min(columns, rows) == _FEWEST[wish.pattern]
            if (is_usual or not is_free) and _can_be_told(wish.pattern, columns, rows):
                yield columns, rows


def _can_be_told(pattern: Pattern, columns: int, rows: int) -> bool:
    """Whether a picture shows which way up such a board is."""
    return pattern is not Pattern.CHECKERBOARD or (columns + rows) % 2 == 1


def _of_metres(pattern: Pattern, columns: int, rows: int) -> Face:
    """The board with squares of a metre; raises TargetError where there is no such board."""
    keys = {}
    if pattern is not Pattern.CHECKERBOARD:
        keys = {"marker": _MARKER_SHARE[pattern], "dictionary": _DICTIONARIES[pattern][0]}
    if pattern is Pattern.APRILGRID:
        keys |= {"border_bits": 2, "numbering": Numbering.KALIBR}
    try:
        return Face(0, pattern, columns, rows, 1.0, *NOWHERE, **keys)
    except ValueError as reason:
        raise TargetError(str(reason)) from None


def _with_square(board: Face, wish: Wish, room: tuple[float, float]) -> Face | None:
    """The board with the square that is wished or the largest that fits; None where none does."""
    most = min(side / wide for side, wide in zip(room, print_size(board), strict=True))
    square = wish.square
    if square is None:
        square = round(math.floor((most + _EQUAL_M) / _STEP_M) * _STEP_M, 6)
        square = square if square >= _SMALLEST_M else math.inf
    if not 0 < square <= most + _EQUAL_M:
        return None
    if board.marker is None:
        return structs.replace(board, square=square)
    # Rounded up, so that a grid's outer squares, which are what markers leave, still fit.
    marker = round(math.ceil(board.marker * square * 1e4 - 1e-6) / 1e4, 6)
    return structs.replace(board, square=square, marker=marker)


def _with_markers(board: Face, copies: int) -> Face:
    """The board with the smallest dictionary that has markers for all copies."""
    if board.marker is None:
        return board
    needed = copies * board.marker_count
    *_, largest = names = _DICTIONARIES[board.pattern]
    for name in names:
        if len(predefined_dictionary(name).bytesList) >= needed:
            return structs.replace(board, dictionary=name)
    raise TargetError(
        f"{copies} boards of {board.columns} x {board.rows} need {needed} markers, and "
        f"{largest} has fewer; give fewer columns or rows"
    )


def _does_not_fit(wish: Wish, rooms: Sequence[tuple[float, float]]) -> str:
    said = [
        f"{count} {what}"
        for count, what in ((wish.columns, "columns"), (wish.rows, "rows"))
        if count is not None
    ]
    said += [f"squares of {wish.square * 1000:g} mm"] if wish.square is not None else []
    words = f" with {' and '.join(said)}" if said else ""
    width, height = max(rooms, key=lambda room: room[0] * room[1])
    return (
        f"no {wish.pattern.value}{words} fits: there is room for {max(width, 0) * 1000:.0f} x "
        f"{max(height, 0) * 1000:.0f} mm; give smaller numbers, a larger box or a larger --sheet"
    )
