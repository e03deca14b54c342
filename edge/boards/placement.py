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


def placed(
    grid: Grid, looks: Sequence[Appearance], size: tuple[int, int], fit: PlanarFit | None = None
) -> Placement | None:
    """The best place of the best of some boards on a grid; None where it shows too little of them,
    or leaves open where they lie.

    `size`: of the picture; `fit`: of the face of the only look, where it is known.
    """
    shapes = [(look.face.columns - 1, look.face.rows - 1, look.face.inverted) for look in looks]
    ids, which = np.empty(len(grid)), np.empty(2)
    count = _PLACED(
        grid.rows,
        np.array(shapes, float),
        *size,
        _NO_FIT if fit is None else fit.packed,
        0.0 if fit is None else looks[0].face.square,
        TUNING.least_share,
        TUNING.enough_px,
        ids,
        which,
    )
    if not count:
        return None
    on_board = ids >= 0
    board = grid.pixels[on_board]
    return Placement(looks[int(which[0])], ids[on_board].astype(int), board, grid.only(~on_board))


def keeps_its_place(look: Appearance, found: Measured, size: tuple[int, int]) -> bool:
    """Whether measured corners leave no doubt which they are: some that spoke for the place may
    have turned out to be none. `size`: of the picture."""
    face, ids = look.face, found.corners
    places = np.stack([ids % (face.columns - 1), ids // (face.columns - 1)], axis=-1).astype(int)
    is_dark = (places.sum(axis=1) % 2 == 0) ^ face.inverted
    again = placed(Grid(places, found.pixels, is_dark), [look], size, found.fit)
    # What a board looks like after half a turn, it may be.
    either = ids, face.corner_count - 1 - ids
    return again is not None and any(np.array_equal(again.ids, same) for same in either)
