"""What numpy says of samples, but without `numpy.ma`: `np.unique`, `np.median` and `np.quantile`
import it, which takes a short program as long as a fifth of numpy."""

import numpy as np
from numpy.typing import ArrayLike

from .rotation import Array


def unique(values: ArrayLike, axis: int | None = None) -> np.ndarray:
    """The distinct values in order; along an `axis`: the distinct rows or columns."""
    return np.unique(values, return_index=True, axis=axis)[0]


def quantile(values: ArrayLike, share: float) -> float:
    """What this `share` of the values, of which none is NaN, lies below: interpolated between the
    nearest two, infinite where one is that counts. Raises IndexError where there are no values."""
    ordered: Array = np.sort(np.asarray(values, dtype=float), axis=None)
    place = share * (ordered.size - 1)
    row = int(place)
    rest = place - row
    low, high = ordered.item(row), ordered.item(min(row + 1, ordered.size - 1))
    return low if rest == 0 or low == high else (1 - rest) * low + rest * high


def median(values: ArrayLike) -> float:
    """The value in the middle, or the mean of both that are; otherwise as `quantile`."""
    return quantile(values, 0.5)
