"""Where a ChArUco board ends, against where its file says.

A legacy board with an odd number of columns is, but for its last column, the board that a file
without `legacy` describes, less that one's first column: its markers contradict nothing while the
last column is out of the picture.
"""

from functools import cache
from itertools import product

import numpy as np

from trigpoint.edge.registration.measurement import Measured
from trigpoint.edge.registration.planar_fit import FIT
from trigpoint.edge.registration.printed_pattern import squares_are_light
from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In, Kernel
from trigpoint.site.target import Face

from .distances import chebyshev
from .markers import LEAST_CONTRAST

# Where a line of squares is looked at: how deep from its edge, and between its squares' sides; in
# squares, as the distance of what is looked at from the nearest corner. Of a light square its
# marker's border, in the marker's sides.
_DEEP, _BETWEEN, _REACH = np.array([0.1, 0.2]), np.array([0.3, 0.5, 0.7]), 1.6
_BORDER_DEEP = np.array([0.05, 0.1])
# Each of the four squares that meet at a corner is looked at between that and its marker.
_BESIDE = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
ENDS_EARLY = Kernel(
    "tp_ends_early",
    In(np.uint8, ("h", "w")),
    In(np.float64, (FIT,)),
    In(np.int64, ("k",)),
    In(np.float64, ("corners", 8)),
    float,
    In(np.float64, ("n", 12)),
    In(np.int64, ("n",)),
    In(np.bool_, ("n", "corners")),
)


def ends_early(grey: np.ndarray, face: Face, found: Measured) -> bool:
    """Whether a board ends one line of squares before the file says: all along an outermost line
    its squares are light from the inner edge on, where they or their markers are dark, and the next
    line is as printed up to there. What hides a line does not end so exactly at its edge. No, where
    what is dark and what is light around the corners are too alike."""
    beside, *looked_at = _looked_at(face)
    return (
        ENDS_EARLY(
            np.ascontiguousarray(grey),
            found.fit.packed,
            found.corners,
            beside,
            LEAST_CONTRAST,
            *looked_at,
        )
        == 1
    )


@cache
def _looked_at(face: Face) -> tuple[Array, Array, np.ndarray, np.ndarray]:
    """For the core: what is beside each corner, (corners, 8), four face places; where the dark
    squares of the two lines on each side, and the markers of the outer one, are looked at, (n, 12),
    six; of which line each is, (n,): of side k the outer one is 2 k, the inner one 2 k + 1; and
    whether it is looked at where a corner is seen, (n, corners)."""
    places, lines = list[Array](), list[int]()
    marker = (face.marker or 0.0) / face.square
    inset = (1 - marker) / 2
    border = inset + marker * _BORDER_DEEP, inset + marker * _BETWEEN
    for side, (is_column, is_last) in enumerate(product((True, False), (True, False))):
        along, count = (face.rows, face.columns) if is_column else (face.columns, face.rows)
        edge = count - 1 if is_last else 1  # between the two lines, in squares
        for inner in (False, True):
            way = 1 if is_last is not inner else -1
            line = edge if way > 0 else edge - 1
            for step in range(along):
                square = (line, step) if is_column else (step, line)
                is_light = squares_are_light(face, *map(np.array, square))
                if is_light and inner:
                    continue
                deep, between = border if is_light else (_DEEP, _BETWEEN)
                across, beside = np.meshgrid(edge + way * deep, step + between)
                spots = [across, beside] if is_column else [beside, across]
                places.append((np.stack(spots, axis=-1).reshape(-1, 2) - 1) * face.square)
                lines.append(2 * side + inner)
    corners = face.corners[:, :2]
    beside = corners[:, None] + (face.square - (face.marker or 0.0)) / 4 * _BESIDE
    reached = chebyshev(np.mean(places, axis=1), corners) < _REACH * face.square
    flat = np.array(places).reshape(-1, 12)
    return beside.reshape(-1, 8), flat, np.array(lines), reached
