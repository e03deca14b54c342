"""Distances of places from each other."""

import numpy as np

from trigpoint.geometry.rotation import Array


def chebyshev(first: Array, second: Array) -> Array:
    """How far places (n, 2) lie from others (m, 2), each along the axis on which that is more,
    (n, m)."""
    x, y = (np.abs(first[:, None, axis] - second[:, axis]) for axis in (0, 1))
    return np.maximum(x, y, out=x)
