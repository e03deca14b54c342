"""What a picture shows of a board with markers that could not be, were the target file true.

A board of another layout agrees with the file in most of its markers, moved by a square: legacy
ChArUco boards do. So everything that lies on the board's own grid is read, and held against what
the file has there: another marker, or one beyond the board's edge, says that the file is wrong;
nothing at all says little, since a hand hides markers too.
"""

from functools import lru_cache

import numpy as np
from msgspec import Struct

from trigpoint.edge.registration.measurement import Measured
from trigpoint.geometry.rotation import Array
from trigpoint.site.target import Pattern

from .board_ends import ends_early
from .distances import chebyshev
from .marked_board import MarkedBoard
from .markers import MarkerReader

# How far a quadrilateral's corners may lie from where a marker's would be, of its side: half of
# what a chessboard square is larger than its marker.
_NEAR = 0.15
# Only what is so near to a measured corner is compared: beyond, a fit to a few of them has no say.
_REACH_SQUARES = 2.6
# Correlation of a marker's code: surely this marker (one bit of 16 wrong); as well as not; and as
# well as it, since another one has 0, by chance a quarter.
_SURELY, _HARDLY, _PROBABLY = 0.85, 0.25, 0.5
# Quadrilaterals at markers' places that are no marker of the file: as many are chance.
_MOST_FOREIGN = 1
# Which corner comes first, second and so on, of a quadrilateral that is turned so often.
_TURNS = (np.arange(4)[:, None] + np.arange(4)) % 4


class Contradictions(Struct, frozen=True):
    """`agreeing`: markers where the file has them; `elsewhere`: the file's dictionary's at other
    places; `foreign`: what is like a marker on the board, and is not the one that the file has."""

    agreeing: int
    elsewhere: int
    foreign: int

    @property
    def are_plain(self) -> bool:
        """Whether the file cannot be true: an accident shows one foreign marker, not more of them
        than agree, and none of the board's own in the wrong place."""
        return self.elsewhere > 0 or self.foreign > max(_MOST_FOREIGN, self.agreeing)


def contradictions(
    grey: np.ndarray, board: MarkedBoard, found: Measured, quads: Array, reader: MarkerReader
) -> Contradictions:
    """What dark quadrilaterals (n, 4, 2) on a board's grid say about its description, and where it
    ends; `reader`: of every marker of its dictionary."""
    if board.face.pattern is Pattern.CHARUCO and ends_early(grey, board.face, found):
        return Contradictions(0, 1, 0)
    cells, expected, within, reached = _cells(board)
    near = np.flatnonzero(reached[:, found.corners].any(axis=1))
    placed = found.fit.project(cells[near].reshape(-1, 2)).reshape(-1, 4, 2)
    which, there = _at(placed, quads)
    if len(which) == 0:
        return Contradictions(0, 0, 0)
    scores = reader.codes(grey, there)
    numbers = expected[near][which]
    own = scores[np.arange(len(which)), np.maximum(numbers, 0) + board.face.first_marker]
    own[numbers < 0] = 0.0
    agrees = own > _PROBABLY
    # A place is seen as several quadrilaterals: what agrees there settles it.
    has_own = np.zeros(len(near), bool)
    has_own[which[agrees]] = True
    settled = has_own[which]
    elsewhere = ~settled & (scores.max(axis=1) > _SURELY)
    # Where not one of its markers is surely read, what is not probably its own is none of it, and
    # what is like a marker beyond its edge is of a board that goes on.
    is_sure = bool(np.any(own > _SURELY))
    is_other = (own < _HARDLY) & within[near][which] if is_sure else own < _PROBABLY
    foreign = ~settled & ~elsewhere & is_other & scores.any(axis=1)
    return Contradictions(*(len(set(which[is_so])) for is_so in (agrees, elsewhere, foreign)))


@lru_cache(1024)
def _cells(board: MarkedBoard) -> tuple[Array, np.ndarray, np.ndarray, np.ndarray]:
    """Where markers could be on a board's grid and one place beyond, (n, 4, 2), clockwise from
    their top left; the number of the file's marker there, -1 where it has none; whether that is on
    the board; and whether it is compared where a corner is seen, (n, corners). None of these is
    written to."""
    face, layout = board.face, board.layout
    steps = np.rint((layout.mean(axis=1) - layout[0].mean(axis=0)) / face.square).astype(int)
    # Around all squares of a ChArUco board, of which every other one has a marker.
    low, high = steps.min(axis=0) - 1, steps.max(axis=0) + 1
    if face.pattern is Pattern.CHARUCO:
        low, high = low - 1, high + 1
    x, y = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
    places = np.stack([x, y], axis=-1).reshape(-1, 2)
    numbers = {tuple(step): number for number, step in enumerate(steps.tolist())}
    expected = np.array([numbers.get((a, b), -1) for a, b in places.tolist()])
    middle = layout[0].mean(axis=0) + places * face.square
    low, high = face.outline.min(axis=0)[:2], face.outline.max(axis=0)[:2]
    within = np.all((middle > low) & (middle < high), axis=1)
    reached = chebyshev(middle, board.pattern.points) < _REACH_SQUARES * face.square
    return layout[0] + (places * face.square)[:, None], expected, within, reached


def _at(placed: Array, quads: Array) -> tuple[np.ndarray, Array]:
    """The quadrilaterals that lie where markers `placed` (n, 4, 2) would: of which place each,
    (k,), and its corners (k, 4, 2) from the same one on."""
    sides = np.linalg.norm(placed[:, _TURNS[3]] - placed, axis=-1).mean(axis=1)
    apart = chebyshev(placed.mean(axis=1), quads.mean(axis=1))
    which, index = np.nonzero(apart < _NEAR * sides[:, None])
    turned = quads[index][:, _TURNS]
    off = np.linalg.norm(turned - placed[which][:, None], axis=-1).mean(axis=-1)
    turn = off.argmin(axis=1)
    near = off.min(axis=1) < _NEAR * sides[which]
    return which[near], turned[near, turn[near]]
