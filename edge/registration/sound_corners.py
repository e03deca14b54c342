"""Which of a face's corners are where a flat face has them, and which are wild."""

import numpy as np

from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In, Kernel, Out

from .planar_fit import FIT, PlanarFit
from .plane_fitting import start_of

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
    `enough_px`: of
    `settled_fit`, the same where it is left out; `start`: a fit that is nearly right. Drops the
    worst beyond five sigmas of the others' spread, again and again; no corner is sound where fewer
    than four remain or all scatter.
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
