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
# Pictures whose greys, but for two thousandths, span less than an eighth of all show no board well.
_FLAT, _GLARING = 32, 0.1


def squares_seen(given: Sequence[Given], topics: Sequence[str] = ()) -> str:
    """The board of black and white squares that several of the first pictures show whole, in words;
    "" where there is none."""
    search, seen = GridSearch(), list[tuple[int, int] | None]()
    for still in islice(stills(given, topics), _LOOKED_AT):
        search.take(still.picture)
        seen += [_size(grid.cleaned()) for grid in search.grids(1)]
    whole = Counter(size for size in seen if size)
    (columns, rows), count = (whole.most_common(1) or [((0, 0), 0)])[0]
    if count < max(_LEAST, _MOST_SHARE * len(seen)):
        return ""
    return f"{count} of the first pictures show a board of {columns} × {rows} squares"


def greys_seen(given: Sequence[Given], topics: Sequence[str] = ()) -> str:
    """That each of the first pictures is nearly one grey, in words, and after the last semicolon
    what to do; "" where one is not."""
    first = [still.picture for still in islice(stills(given, topics), _LOOKED_AT)]
    greys = np.array([np.percentile(each, [_GLARING, 100 - _GLARING]) for each in first])
    if not len(greys) or np.any(np.ptp(greys, axis=1) >= _FLAT):
        return ""
    span, low, high = np.ceil([np.ptp(greys, axis=1).max(), greys.min(), greys.max()]).astype(int)
    return (
        f"each of the first pictures is nearly one grey: 998 of 1000 pixels lie within {span} of "
        f"255 greys, from {low} in the darkest to {high} in the brightest; see to the lens's cap, "
        "light, exposure, and how the pictures are encoded"
    )


def _size(grid: Grid) -> tuple[int, int] | None:
    """Columns and rows of squares, the larger first, of a grid without gaps; else None."""
    width, height = grid.extent
    if not len(grid) == width * height >= LEAST_CORNERS:
        return None
    return max(width, height) + 1, min(width, height) + 1
