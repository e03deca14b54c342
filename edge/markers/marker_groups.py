"""Puts markers that may be right together to boards: those that agree on where the board lies, by
the compiled core (`native/src/markers/groups.cpp`)."""

from itertools import pairwise

import numpy as np
from msgspec import Struct

from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In, Kernel, Out

from .markers import Markers

# Correlation of a marker's cells, to join a board.
LEAST_MEMBER = 0.45
MOST_GROUPS = 8
# Of the likeliest markers, how many are looked at.
MOST_MARKERS = 400
_GROUPS = Kernel(
    "tp_marker_groups",
    In(np.int64, ("n",)),
    In(np.float64, ("n", 8)),
    In(np.float64, ("n",)),
    In(np.float64, ("markers", 8)),
    Out(np.int64, ("n",)),
    Out(np.int64, ("g",)),
)


class MarkerGroup(Struct, frozen=True):
    """Markers of one board in one place. `numbers`: (k,); `corners`: (k, 4, 2) pixels; `quads`:
    (k,) which quadrilaterals; `weight`: the sum of scores, to choose among groups that share any.
    """

    numbers: np.ndarray
    corners: Array
    quads: np.ndarray
    weight: float


def group_markers(markers: Markers, layout: Array) -> list[MarkerGroup]:
    """The boards that markers show, heaviest first; several where one look is seen several times.

    `layout`: (m, 4, 2) the markers' corners on the board, clockwise from the top left.
    """
    markers = markers.first(MOST_MARKERS)
    members, ends = np.empty(len(markers), np.int64), np.empty(MOST_GROUPS, np.int64)
    count = _GROUPS(
        np.ascontiguousarray(markers.numbers, np.int64),
        np.ascontiguousarray(markers.corners).reshape(-1, 8),
        np.ascontiguousarray(markers.scores),
        np.ascontiguousarray(layout, float).reshape(-1, 8),
        members,
        ends,
    )
    parts = [members[begin:end] for begin, end in pairwise([0, *ends[:count].tolist()])]
    groups = [
        MarkerGroup(
            markers.numbers[part],
            markers.corners[part],
            markers.quads[part],
            float(markers.scores[part].sum()),
        )
        for part in parts
    ]
    return sorted(groups, key=lambda group: -group.weight)
