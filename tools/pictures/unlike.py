"""What is said of pictures in which none of the target's boards is found, and nothing says why."""

from collections import Counter
from collections.abc import Sequence
from itertools import islice

import numpy as np

from trigpoint.edge.boards.grid import LEAST_CORNERS, Grid, GridSearch

from .detect import Given, stills

# So many pictures are looked at again; so many, and most of those with any squares, show a board
# that is there: a hand, or what stands before it, leaves another part of it each time.
_LOOKED_AT, _LEAST, _MOST_SHARE = 10, 3, 0.7
# Pictures whose greys, but for a thousandth, span less than an eighth of all show no board well.
_FLAT, _GLARING = 32, 0.1


def squares_seen(given: Sequence[Given], topics: Sequence[str] = ()) -> str:
    """The board of black and white squares that several of the first pictures show whole, or that
    they are all but one grey, in words; "" where there is neither."""
    search, seen, greys = GridSearch(), list[tuple[int, int] | None](), list[np.ndarray]()
    for still in islice(stills(given, topics), _LOOKED_AT):
        greys.append(np.percentile(still.picture, [_GLARING, 100 - _GLARING]))
        search.take(still.picture)
        seen += [_size(grid.cleaned()) for grid in search.grids(1)]
    whole = Counter(size for size in seen if size)
    if not whole:
        return _flat(np.array(greys))
    (columns, rows), count = whole.most_common(1)[0]
    if count < max(_LEAST, _MOST_SHARE * len(seen)):
        return ""
    return f"{count} of the first pictures show a board of {columns} × {rows} squares"


def _flat(greys: np.ndarray) -> str:
    """That pictures whose greys lie between these (n, 2) are too dark, bright or dull; "" where one
    is not."""
    if not len(greys) or np.any(np.ptp(greys, axis=1) >= _FLAT):
        return ""
    low, high = round(greys[:, 0].min()), round(greys[:, 1].max())
    return (
        f"the first pictures have no greys but {low} to {high} of 0 to 255: see to the lens's cap, "
        "light, exposure, and how the pictures are encoded"
    )


def _size(grid: Grid) -> tuple[int, int] | None:
    """Columns and rows of squares, the larger first, of a grid without gaps; else None."""
    width, height = grid.extent
    if not len(grid) == width * height >= LEAST_CORNERS:
        return None
    return max(width, height) + 1, min(width, height) + 1
