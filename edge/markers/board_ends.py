"""Where a ChArUco board ends, against where its file says.

A legacy board with an odd number of columns is, but for its last column, the board that a file
without `legacy` describes, less that one's first column: its markers contradict nothing while the
last column is out of the picture.
"""

from functools import cache
from itertools import product

import numpy as np

from trigpoint.edge.image.median import median
from trigpoint.edge.image.sampling import sampled
from trigpoint.edge.registration.measurement import Measured
from trigpoint.edge.registration.printed_pattern import squares_are_light
from trigpoint.geometry.rotation import Array
from trigpoint.site.target import Face

from .distances import chebyshev
from .markers import LEAST_CONTRAST

# Where a line of squares is looked at: how deep from its edge, and between its squares' sides; in
# squares, as the distance of what is looked at from the nearest corner. Of a light square its
# marker's border, in the marker's sides.
_DEEP, _BETWEEN, _REACH = np.array([0.1, 0.2]), np.array([0.3, 0.5, 0.7]), 1.6
_BORDER_DEEP = np.array([0.05, 0.1])
# Squares of one line: the file's own may be lost to a glare one at a time.
_LEAST_GONE = 2
# Each of the four squares that meet at a corner is looked at between that and its marker.
_BESIDE = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])


def ends_early(grey: np.ndarray, face: Face, found: Measured) -> bool:
    """Whether a board ends one line of squares before the file says: all along an outermost line
    its squares are light from the inner edge on, where they or their markers are dark, and the next
    line is as printed up to there. What hides a line does not end so exactly at its edge."""
    middle = _middle(grey, face, found)
    if middle is None:
        return False
    places, lines, reached = _looked_at(face)
    near = reached[:, found.corners].any(axis=1)
    places, lines = places[near], lines[near]
    pixels = found.fit.project(places.reshape(-1, 2)).reshape(places.shape)
    is_in = np.all((pixels > 1) & (pixels < np.array(grey.shape[::-1]) - 2), axis=(1, 2))
    values, lines = sampled(grey, pixels[is_in]), lines[is_in]
    all_count, light, dark = (
        np.bincount(lines[which], minlength=8).reshape(4, 2)
        for which in (slice(None), values.min(axis=1) > middle, values.max(axis=1) < middle)
    )
    (outer, inner), gone, printed = all_count.T, light[:, 0], dark[:, 1]
    is_early = (outer >= _LEAST_GONE) & (gone == outer) & (inner > 0) & (printed == inner)
    return bool(is_early.any())


def _middle(grey: np.ndarray, face: Face, found: Measured) -> float | None:
    """The grey value between what is dark and what is light around the corners; None where that
    is too alike."""
    corners = found.corners
    half = (face.square - (face.marker or 0.0)) / 4
    spots = face.corners[corners, None, :2] + half * _BESIDE
    pixels = found.fit.project(spots.reshape(-1, 2)).reshape(spots.shape)
    values = np.sort(sampled(grey, pixels), axis=1)
    dark, light = median(values[:, 1]), median(values[:, 2])
    return (dark + light) / 2 if light - dark > LEAST_CONTRAST else None


@cache
def _looked_at(face: Face) -> tuple[Array, np.ndarray, np.ndarray]:
    """Where the dark squares of the two lines on each side, and the markers of the outer one, are
    looked at, (n, 6, 2) face places; of which line each is, (n,): of side k the outer one is 2 k,
    the inner one 2 k + 1; and whether it is looked at where a corner is seen, (n, corners). None of
    these is written to."""
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
    middles = np.mean(places, axis=1)
    reached = chebyshev(middles, face.corners) < _REACH * face.square
    return np.array(places), np.array(lines), reached
