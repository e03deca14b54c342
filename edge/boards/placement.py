"""Where on a grid of corners a board lies, by the core (`native/src/boards/placement.hpp`)."""

from collections.abc import Sequence

import numpy as np
from msgspec import Struct

from trigpoint.edge.registration.appearance import Appearance
from trigpoint.edge.registration.measurement import Measured
from trigpoint.edge.registration.planar_fit import FIT, PlanarFit
from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In, Kernel, Out

from .grid import GRID, Grid
from .tuning import TUNING

_PLACED = Kernel(
    "tp_placed",
    GRID,
    In(np.float64, ("k", 3)),
    float,
    float,
    In(np.float64, (FIT,)),
    float,
    float,
    float,
    Out(np.float64, ("n",)),
    Out(np.float64, (2,)),
)
_NO_FIT = np.zeros(FIT)


class Placement(Struct, frozen=True, eq=False):
    """A board on a grid. `ids`: (n,) of the board's corners; `pixels`: (n, 2) where they are;
    `rest`: the grid's other corners."""

    look: Appearance
    ids: np.ndarray
    pixels: Array
    rest: Grid


def placed(grid: Grid, looks: Sequence[Appearance], size: tuple[int, int]) -> Placement | None:
    """The best place of the best of some boards on a grid; None where it shows too little of them,
    or leaves open where they lie. `size`: of the picture."""
    best = _best(grid.rows, looks, size)
    if best is None:
        return None
    look, ids = best
    on_board = ids >= 0
    board = grid.rows[on_board, 2:4]
    return Placement(look, ids[on_board].astype(int), board, grid.only(~on_board))


def keeps_its_place(look: Appearance, found: Measured, size: tuple[int, int]) -> bool:
    """Whether measured corners leave no doubt which they are: some that spoke for the place may
    have turned out to be none. `size`: of the picture."""
    face, ids = look.face, found.corners
    y, x = np.divmod(ids, face.columns - 1)
    rows = np.empty((len(ids), 5))
    rows[:, 0], rows[:, 1], rows[:, 2:4] = x, y, found.pixels
    rows[:, 4] = (x + y) % 2 == face.inverted
    best = _best(rows, [look], size, found.fit)
    # What a board looks like after half a turn, it may be.
    either = ids, face.corner_count - 1 - ids
    return best is not None and any(bool(np.all(best[1] == same)) for same in either)


def _best(
    rows: Array, looks: Sequence[Appearance], size: tuple[int, int], fit: PlanarFit | None = None
) -> tuple[Appearance, Array] | None:
    """Which board lies best on a grid (n, 5), and which of its corners each of that is, (n,), below
    0 where none. `fit`: of the face of the only look, where it is known."""
    shapes = [(look.face.columns - 1, look.face.rows - 1, look.face.inverted) for look in looks]
    ids, which = np.empty(len(rows)), np.empty(2)
    count = _PLACED(
        rows,
        np.array(shapes, float),
        *size,
        _NO_FIT if fit is None else fit.packed,
        0.0 if fit is None else looks[0].face.square,
        TUNING.least_share,
        TUNING.enough_px,
        ids,
        which,
    )
    return (looks[int(which[0])], ids) if count else None
