"""Thins out a sequence evenly."""

import numpy as np


def thinned(count: int, most: int) -> np.ndarray:
    """Indices of at most `most` of `count` things in order, evenly spread, the first and the last
    included."""
    if count <= most:
        return np.arange(count)
    return np.linspace(0, count - 1, most).round().astype(int)
