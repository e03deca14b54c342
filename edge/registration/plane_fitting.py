"""Fits planes and lenses to the corners of a face, by the core (`native/src/registration`).

A weak prior towards no lens, and towards one in the picture's middle, keeps noise from looking like
one.
"""

import numpy as np

from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In, Kernel, Out

from .planar_fit import FIT, PlanarFit

_FIT, _POINTS = In(np.float64, (FIT,)), In(np.float64, ("n", 2))
_FOUND = Out(np.float64, (FIT,))
_FIT_PLANE = Kernel("tp_fit_plane", _POINTS, _POINTS, _FIT, int, int, _FOUND)
_SETTLED = Kernel("tp_settled_fit", _POINTS, _POINTS, _FIT, int, float, _FOUND)


def fit_plane(
    points: Array,
    pixels: Array,
    size: tuple[int, int],
    *,
    has_lens: bool = True,
    start: PlanarFit | None = None,
) -> PlanarFit | None:
    """The fit to face points (n, 2) and pixels (n, 2); None where they fix no plane (n < 4).

    `size`: the picture's width and height; `start`: one of that size to begin with, and to take the
    lens from where `has_lens` is False; without it that gives a homography alone.
    """
    found = np.empty(FIT)
    ends = np.ascontiguousarray(points, float), np.ascontiguousarray(pixels, float)
    is_found = _FIT_PLANE(*ends, start_of(size, start), start is not None, has_lens, found)
    return PlanarFit(found) if is_found else None


def settled_fit(
    points: Array,
    pixels: Array,
    size: tuple[int, int],
    enough_px: float,
    *,
    start: PlanarFit | None = None,
) -> PlanarFit | None:
    """Like `fit_plane`; lens and bend stay those of `start`, or none, where all points come within
    `enough_px` so: the search for a better one is long where a face hardly shows it."""
    found = np.empty(FIT)
    ends = np.ascontiguousarray(points, float), np.ascontiguousarray(pixels, float)
    is_found = _SETTLED(*ends, start_of(size, start), start is not None, enough_px, found)
    return PlanarFit(found) if is_found else None


def start_of(size: tuple[int, int], start: PlanarFit | None) -> Array:
    """Where a fit begins, for the core: at `start`, or at a picture's size alone."""
    return (start or PlanarFit.of_size(size)).packed
