"""The grids that a picture's X corners form, found, cleaned and made whole by the compiled core
(`native/src/boards`)."""

from itertools import pairwise

import numpy as np
from msgspec import Struct

from trigpoint.geometry.rotation import Array
from trigpoint.native.library import Handle, In, Kernel, Out

# As of `boards/saddles.hpp`, the strongest stay, and of `boards/grid.hpp`.
MOST_CORNERS, LEAST_CORNERS = 800, 9


class _Curvature(Handle):
    """A picture's curvature and what was found in it, kept for the next picture."""

    name = "tp_curvature"


GRID = In(np.float64, ("n", 5))
_SADDLES = Kernel("tp_saddles", _Curvature, In(np.uint8, ("h", "w")))
_HALF_SADDLES = Kernel("tp_half_saddles", _Curvature, _Curvature)
_GRIDS = Kernel("tp_grids", _Curvature, Out(np.float64, ("n", 5)), Out(np.float64, ("m",)))
_CLEANED = Kernel("tp_cleaned", GRID, Out(np.float64, ("n", 5)))
_GROWN = Kernel("tp_grown", _Curvature, GRID, int, Out(np.float64, ("m", 5)))
# More than a grid can grow to: two lines of places on each side, a few times over.
_MOST_GROWN = 8 * MOST_CORNERS


class Grid(Struct, frozen=True):
    """A connected grid of corners.

    `rows`: (n, 5), as the core has it: whole x and y, x × y pointing into the picture (never
    mirrored); the pixel; whether the square towards (-x, -y) is dark.
    """

    rows: Array

    def __len__(self) -> int:
        return len(self.rows)

    def only(self, keep: np.ndarray) -> "Grid":
        """The grid of the corners where `keep` (n,) is true."""
        return Grid(self.rows[keep])

    @property
    def extent(self) -> tuple[int, int]:
        """How many corners wide and high the grid is."""
        if len(self) == 0:
            return 0, 0
        places = self.rows[:, :2]
        width, height = np.maximum.reduce(places) - np.minimum.reduce(places) + 1
        return int(width), int(height)

    def cleaned(self) -> "Grid":
        """The grid without corners that do not lie where their neighbours have them."""
        kept = np.empty((len(self), 5))
        return Grid(kept[: _CLEANED(self.rows, kept)])


class GridSearch:
    """Finds grids in one picture after the other, and keeps the last one; for one thread."""

    def __init__(self) -> None:
        self._curvature = _Curvature()
        self._rows = np.empty((_MOST_GROWN, 5))
        self._sizes = np.empty(MOST_CORNERS // LEAST_CORNERS)

    def take(self, grey: np.ndarray) -> int:
        """Look at a grey picture, (height, width) uint8; how many X corners it has."""
        return _SADDLES(self._curvature, np.ascontiguousarray(grey))

    def take_half(self, finer: "GridSearch") -> int:
        """Look at another's last picture at half its size, whose (x, y) is (2x, 2y) of it; how many
        X corners it has."""
        return _HALF_SADDLES(self._curvature, finer._curvature)

    def grids(self, most: int | None = None) -> list[Grid]:
        """The grids of enough corners in the last picture, the largest first; all, or `most`."""
        count = _GRIDS(self._curvature, self._rows, self._sizes)
        ends = np.cumsum(self._sizes[:count][:most]).astype(int).tolist()
        return [Grid(self._rows[begin:end].copy()) for begin, end in pairwise([0, *ends])]

    def grown(self, grid: Grid, longest: int) -> Grid:
        """The grid with every corner that its own predict and the last picture shows, up to the
        pattern's edge; `longest`: corners along the longest side that is looked for."""
        count = _GROWN(self._curvature, grid.rows, longest, self._rows)
        return Grid(self._rows[:count].copy())
