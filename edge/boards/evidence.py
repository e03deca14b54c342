"""How likely it is that a checkerboard is where a fit has it, by the core
(`native/src/boards/evidence.hpp`)."""

import numpy as np
from msgspec import Struct

from trigpoint.edge.registration.planar_fit import FIT, PlanarFit
from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In, Kernel, Out
from trigpoint.site.target import Face

_WEIGHED = Kernel(
    "tp_weighed",
    In(np.uint8, ("h", "w")),
    int,
    int,
    float,
    In(np.float64, (FIT,)),
    In(np.int64, ("n",)),
    In(np.float64, ("n", 2)),
    Out(np.float64, (5,)),
)


class Evidence(Struct, frozen=True):
    """`board`: log odds of the board against clutter, nats; `ends`: the same of its end against a
    board that goes on, top, bottom, left and right, 0 where the picture ends before that;
    `is_board`: whether no doubt is left that it is there and is no part of a larger one."""

    board: float
    ends: tuple[float, ...]
    is_board: bool


def weighed(
    grey: np.ndarray, face: Face, fit: PlanarFit, ids: np.ndarray, pixels: Array
) -> Evidence:
    """The evidence for a board in a picture (h, w) uint8 where `fit` has it. `ids`: (n,) the
    corners that are seen, at `pixels` (n, 2); squares with none of them are hidden, and say
    nothing."""
    told = np.empty(5)
    is_board = _WEIGHED(
        np.ascontiguousarray(grey),
        face.columns - 1,
        face.rows - 1,
        face.square,
        fit.packed,
        ids,
        np.ascontiguousarray(pixels, float),
        told,
    )
    return Evidence(float(told[0]), tuple(told[1:].tolist()), bool(is_board))
