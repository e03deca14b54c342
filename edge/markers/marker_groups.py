"""Puts markers that may be right together to boards: those that agree on where the board lies, by
the compiled core (`native/src/markers/groups.cpp`)."""

from itertools import pairwise

import numpy as np
from msgspec import Struct

from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In, Kernel, Out

# Correlation of a marker's cells, to join a board.
LEAST_MEMBER = 0.45
MOST_GROUPS = 8
# Of the likeliest markers, how many are looked at.
MOST_MARKERS = 400
_QUADS, _NUMBERS = In(np.float64, ("n", 8)), Out(np.int64, ("n",))
_GROUPS = Kernel(
    *("tp_marker_groups", _QUADS, In(np.float64, ("n", "all", 4)), int),
    *(In(np.float64, ("markers", 8)), float, int, int),
    *(_NUMBERS, Out(np.float64, ("n", 8)), _NUMBERS),
    *(Out(np.int64, ("g",)), Out(np.float64, ("g",))),
)


class MarkerGroup(Struct, frozen=True):
    """Markers of one board in one place. `numbers`: (k,); `corners`: (k, 4, 2) pixels; `quads`:
    (k,) which quadrilaterals; `weight`: the sum of scores, to choose among groups that share any.
    """

    numbers: np.ndarray
    corners: Array
    quads: np.ndarray
    weight: float


def group_markers(
    quads: Array, scores: Array, first: int, layout: Array, *, fewest: int = 1
) -> list[MarkerGroup]:
    """The boards that quadrilaterals (n, 4, 2) show, heaviest first; several where one look is seen
    several times; none where fewer than `fewest` of them may be its markers.

    `scores`: (n, all, 4) of a `MarkerReader`, of whose markers the board's begin at `first`;
    `layout`: (m, 4, 2) these markers' corners on the board, clockwise from the top left.
    """
    count = len(quads)
    numbers, which = np.empty(count, np.int64), np.empty(count, np.int64)
    corners, weights = np.empty((count, 8)), np.empty(MOST_GROUPS)
    ends = np.empty(MOST_GROUPS, np.int64)
    found = _GROUPS(
        *(np.ascontiguousarray(quads).reshape(-1, 8), scores, first),
        *(np.ascontiguousarray(layout, float).reshape(-1, 8), LEAST_MEMBER, fewest, MOST_MARKERS),
        *(numbers, corners, which, ends, weights),
    )
    corners = corners.reshape(-1, 4, 2)
    groups = [
        MarkerGroup(numbers[begin:end], corners[begin:end], which[begin:end], weight)
        for (begin, end), weight in zip(
            pairwise([0, *ends[:found].tolist()]), weights[:found].tolist(), strict=True
        )
    ]
    return sorted(groups, key=lambda group: -group.weight)
