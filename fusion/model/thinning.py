"""Fewer of many, evenly."""

import numpy as np


def thinned(count: int, most: int) -> np.ndarray:
    """Which of `count` things in order to take, at most so many, the first and the last too."""
    if count <= most:
        return np.arange(count)
    return np.linspace(0, count - 1, most).round().astype(int)
