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
from trigpoint.edge.registration.planar_fit import FIT
from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In, Kernel, Out
from trigpoint.site.target import Pattern

from .board_ends import ends_early
from .distances import chebyshev
from .marked_board import MarkedBoard
from .markers import LEAST_CONTRAST, MarkerReader

# Only what is so near to a measured corner is compared: beyond, a fit to a few of them has no say.
_REACH_SQUARES = 2.6
# Quadrilaterals at markers' places that are no marker of the file: as many are chance.
_MOST_FOREIGN = 1
_CONTRADICTIONS = Kernel(
    *("tp_contradictions", In(np.uint8, ("h", "w")), In(np.float64, (FIT,))),
    *(In(np.int64, ("k",)), In(np.float64, ("n", 8)), In(np.int64, ("n",))),
    *(In(np.bool_, ("n",)), In(np.bool_, ("n", "corners")), In(np.float64, ("q", 8))),
    *(In(np.float64, ("c", 2)), float, In(np.float64, ("c", "m")), Out(np.int64, (3,))),
)


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
    ends, by the core (`native/src/markers/contradictions.cpp`); `reader`: of every marker of its
    dictionary."""
    if board.face.pattern is Pattern.CHARUCO and ends_early(grey, board.face, found):
        return Contradictions(0, 1, 0)
    counts = np.empty(3, np.int64)
    _CONTRADICTIONS(
        *(np.ascontiguousarray(grey), found.fit.packed, found.corners, *_places(board)),
        *(quads.reshape(-1, 8), reader.within, LEAST_CONTRAST, reader.codes, counts),
    )
    return Contradictions(*counts.tolist())


@lru_cache(1024)
def _places(board: MarkedBoard) -> tuple[Array, np.ndarray, np.ndarray, np.ndarray]:
    """For the core: where markers could be on a board's grid and one place beyond, (n, 8),
    clockwise from their top left; the id of the file's marker there, -1 where it has none; whether
    that is on the board; and whether it is compared where a corner is seen, (n, corners)."""
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
    expected[expected >= 0] += face.first_marker
    middle = layout[0].mean(axis=0) + places * face.square
    low, high = face.outline.min(axis=0)[:2], face.outline.max(axis=0)[:2]
    within = np.all((middle > low) & (middle < high), axis=1)
    reached = chebyshev(middle, board.pattern.points) < _REACH_SQUARES * face.square
    cells = layout[0] + (places * face.square)[:, None]
    return cells.reshape(-1, 8), expected, within, reached
