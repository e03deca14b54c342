"""How the whole picture moved between two pictures of one background."""

import cv2
import numpy as np
from msgspec import Struct

from trigpoint.geometry.rotation import Array

from .tiles import Matches

_REACH_PX = 0.5
"""How far a tile may lie from the motion of the others that RANSAC finds."""
_ITERATIONS = 200
_LEAST_TILES = 4


class Motion(Struct, frozen=True, eq=False):
    """`shift`: (2,) pixels, of the picture's middle; `roll`: radians; `zoom`: the relative growth.

    A turn about the vertical or the level axis, or a shift of the camera, shifts the picture; a
    turn about the line of sight rolls it, and a lens that focuses zooms it.
    """

    shift: Array
    roll: float = 0.0
    zoom: float = 0.0

    @classmethod
    def none(cls) -> "Motion":
        """That of a camera that stands still."""
        return cls(np.zeros(2))

    def shifts(self, offsets: Array) -> Array:
        """What it does to points (n, 2), given from the picture's middle: their shifts (n, 2)."""
        matrix = np.array([[self.zoom, -self.roll], [self.roll, self.zoom]])
        return self.shift + offsets @ matrix.T


def motion_of(matches: Matches, middle: Array) -> Motion | None:
    """The motion on which most of the tiles found agree; None where there are too few."""
    found = matches.is_found
    if np.count_nonzero(found) < _LEAST_TILES:
        return None
    before = (matches.middles[found] - middle).astype(np.float32)
    after = before + matches.shifts[found].astype(np.float32)
    matrix, _ = cv2.estimateAffinePartial2D(
        before, after, ransacReprojThreshold=_REACH_PX, maxIters=_ITERATIONS
    )
    if matrix is None:
        return None
    return Motion(matrix[:, 2].astype(float), float(matrix[1, 0]), float(matrix[0, 0] - 1))


def coarse_shift(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """By how many whole pixels (2,) the second of two small pictures (h, w) is shifted, for shifts
    beyond the tiles' reach: the phase correlation of their gradients."""
    window = cv2.createHanningWindow(before.shape[::-1], cv2.CV_32F)
    first, second = (_edges(each) for each in (before, after))
    shift, _ = cv2.phaseCorrelate(first, second, window)
    return np.rint(shift).astype(int)


def _edges(small: np.ndarray) -> np.ndarray:
    """Logarithms of gradients, in which one bright edge counts no more than many faint ones."""
    x, y = cv2.Sobel(small, cv2.CV_32F, 1, 0), cv2.Sobel(small, cv2.CV_32F, 0, 1)
    return np.log1p(cv2.magnitude(x, y))
