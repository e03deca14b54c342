"""What the core asks of a face's corners while it measures them, as tests ask it: which are where a
flat face has them, which are wild, and how far they scatter."""

import numpy as np

from trigpoint.edge.registration.planar_fit import FIT, PlanarFit
from trigpoint.edge.registration.plane_fitting import start_of
from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In, Kernel, Out

LEAST_WILD_PX = 0.7
# Of a face's grid spacing: real boards are not flat to better than this.
LEAST_WILD_SHARE = 0.04
# To the core: enough is what is never called wild.
_AS_LEAST = -1.0
_POINTS = In(np.float64, ("n", 2))
_SOUND = Kernel(
    "tp_sound_corners",
    _POINTS,
    _POINTS,
    In(np.float64, (FIT,)),
    int,
    float,
    In(np.float64, ("n",)),
    float,
    Out(np.float64, ("n",)),
    Out(np.float64, (FIT,)),
)
_SCATTER = Kernel("tp_scatter", In(np.float64, (FIT,)), _POINTS, _POINTS, Out(np.float64, (1,)))


def sound_corners(
    points: Array,
    pixels: Array,
    size: tuple[int, int],
    *,
    least_px: float = LEAST_WILD_PX,
    least_share: float | Array = LEAST_WILD_SHARE,
    enough_px: float | None = None,
    start: PlanarFit | None = None,
) -> tuple[np.ndarray, PlanarFit | None]:
    """Which corners (n,) lie where a flat face has them, and the fit to those.

    `least_px` and `least_share` (of the spacing; one, or (n,)): what is never called wild;
    `enough_px`: of `settled_fit`, the same where it is left out; `start`: a fit that is nearly
    right. Drops the worst beyond five sigmas of the others' spread, again and again; no corner is
    sound where fewer than four remain or all scatter.
    """
    found, keep = np.empty(FIT), np.empty(len(points))
    is_found = _SOUND(
        np.ascontiguousarray(points, float),
        np.ascontiguousarray(pixels, float),
        start_of(size, start),
        start is not None,
        least_px,
        np.broadcast_to(np.asarray(least_share, float), len(points)).copy(),
        _AS_LEAST if enough_px is None else enough_px,
        keep,
        found,
    )
    return keep > 0, PlanarFit(found) if is_found else None


def scatter_about(fit: PlanarFit, points: Array, pixels: Array) -> tuple[float, int]:
    """How far pixels (n, 2) of face points (n, 2) scatter: the sum of squares, pixel², of what no
    homography and no lens near the fit explains of them, and its freedom; 0 for n < 6."""
    squares = np.zeros(1)
    ends = np.ascontiguousarray(points, float), np.ascontiguousarray(pixels, float)
    freedom = _SCATTER(fit.packed, *ends, squares)
    return float(squares[0]), freedom
