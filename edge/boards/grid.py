"""The grids that a picture's X corners form, found, cleaned and made whole by the compiled core
(`native/src/boards`)."""

import numpy as np
from msgspec import Struct

from trigpoint.geometry.rotation import Array
from trigpoint.native.library import Handle, In, Kernel, Out

# As of `boards/saddles.hpp`, the strongest stay, and of `boards/grid.hpp`.
MOST_CORNERS, LEAST_CORNERS = 800, 9


class _Curvature(Handle):
    """A picture's curvature and what was found in it, kept for the next picture."""

    name = "tp_curvature"


GRID = In(np.float64, ("n", 5))  # as `Grid.rows`
_SADDLES = Kernel("tp_saddles", _Curvature, In(np.uint8, ("h", "w")))
_HALF_SADDLES = Kernel("tp_half_saddles", _Curvature, _Curvature)
_GRIDS = Kernel("tp_grids", _Curvature, Out(np.float64, ("n", 5)), Out(np.float64, ("m",)))
_CLEANED = Kernel("tp_cleaned", GRID, Out(np.float64, ("n", 5)))
_GROWN = Kernel("tp_grown", _Curvature, GRID, int, Out(np.float64, ("m", 5)))
# More than a grid can grow to: two lines of places on each side, a few times over.
_MOST_GROWN = 8 * MOST_CORNERS


class Grid(Struct, frozen=True):
    """A connected grid of corners.

    `places`: (n, 2) whole x and y, x × y pointing into the picture (never mirrored); `pixels`:
    (n, 2); `is_dark`: (n,) whether the square towards (-x, -y) is dark.
    """

    places: np.ndarray
    pixels: Array
    is_dark: np.ndarray

    def __len__(self) -> int:
        return len(self.places)

    @classmethod
    def of(cls, rows: Array) -> "Grid":
        """The grid of rows (n, 5) of the core."""
        return cls(rows[:, :2].astype(int), rows[:, 2:4].copy(), rows[:, 4] != 0)

    @property
    def rows(self) -> Array:
        """The same for the core, (n, 5)."""
        return np.column_stack([self.places, self.pixels, self.is_dark]).astype(float)

    def only(self, keep: np.ndarray) -> "Grid":
        """The grid of the corners where `keep` (n,) is true."""
        return Grid(self.places[keep], self.pixels[keep], self.is_dark[keep])

    @property
    def extent(self) -> tuple[int, int]:
        """How many corners wide and high the grid is."""
        if len(self) == 0:
            return 0, 0
        width, height = self.places.max(axis=0) - self.places.min(axis=0) + 1
        return int(width), int(height)

    def cleaned(self) -> "Grid":
        """The grid without corners that do not lie where their neighbours have them."""
        kept = np.empty((len(self), 5))
        return Grid.of(kept[: _CLEANED(self.rows, kept)])


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
        ends = np.cumsum(self._sizes[:count]).astype(int)[:most]
        return [Grid.of(rows) for rows in np.split(self._rows, ends)[:-1]]

    def grown(self, grid: Grid, longest: int) -> Grid:
        """The grid with every corner that its own predict and the last picture shows, up to the
        pattern's edge; `longest`: corners along the longest side that is looked for."""
        return Grid.of(self._rows[: _GROWN(self._curvature, grid.rows, longest, self._rows)])
