"""Places of a floor or a room: which lie near others, and ways over squares; in the compiled
core."""

import numpy as np

from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In, Kernel, Out

_NEAR = Kernel(
    "tp_near",
    *(In(np.float64, ("n", "a")), In(np.float64, ("m", "a")), float),
    Out(np.bool_, ("n",)),
)
_PATHS = Kernel("tp_paths", In(np.int64, ("n", 2)), int, Out(np.float64, ("n",)))


def are_near(points: Array, places: Array, distance_m: float) -> np.ndarray:
    """Which points (n, 2 or 3) are within a distance of any of the places (m, 2 or 3), (n,) bool;
    not those that are not finite."""
    near = np.empty(len(points), dtype=bool)
    _NEAR(*map(np.ascontiguousarray, (points, places)), distance_m, near)
    return near


def path_lengths(squares: np.ndarray, start: int) -> Array:
    """The length of the shortest way from the square at `start` to each of squares (n, 2) of a
    grid, whole numbers in lexical order, by steps to any of the eight neighbours; (n,), in sides of
    a square, inf where there is none."""
    lengths = np.empty(len(squares))
    _PATHS(squares, start, lengths)
    return lengths
