"""What is said of pictures in which none of the target's boards is found, and nothing says why."""

from collections import Counter
from collections.abc import Sequence
from itertools import islice

from trigpoint.edge.boards.grid import GridSearch

from .detect import Given, stills

# So many pictures are looked at again, and so many of them show a board that is there: a hand or
# the picture's edge leaves another part of it each time.
_LOOKED_AT, _LEAST = 10, 3
# Fewer corners than of a board of 4 × 4 squares are any window's.
_LEAST_CORNERS = 9


def squares_seen(given: Sequence[Given], topics: Sequence[str] = ()) -> str:
    """The board of black and white squares that several of the first pictures show whole, in
    words; "" where there is none."""
    search, seen = GridSearch(), Counter[tuple[int, int]]()
    for still in islice(stills(given, topics), _LOOKED_AT):
        search.take(still.picture)
        for grid in search.grids(1):
            width, height = grid.cleaned().extent
            if len(grid) == width * height >= _LEAST_CORNERS:
                seen[max(width, height) + 1, min(width, height) + 1] += 1
    (columns, rows), count = seen.most_common(1)[0] if seen else ((0, 0), 0)
    if count < _LEAST:
        return ""
    return f"{count} of the first pictures show a board of {columns} × {rows} squares"
