"""Which views show the board in the same place: they tell the same, and count as one."""

from collections.abc import Sequence

import numpy as np

from trigpoint.geometry.rotation import Array

from .calibration_views import FEWEST_CORNERS, View

# Views whose corners lie so near each other, of the picture's width, RMS, are one look: a board
# that was held still, or a picture that was copied.
SAME_SHARE = 0.01
_DIGITS = 6


def looks_of(views: Sequence[View], width: int) -> np.ndarray:
    """The number of each view's look, (views,), from 0 on; `width`: of the picture, pixels."""
    table = _table(views)
    looks = np.full(len(views), -1)
    first: list[int] = []
    for i in range(len(views)):
        if first:
            apart = np.min([_apart(table[first], way) for way in _ways(table[i])], axis=0)
            nearest = int(np.argmin(apart))
            if apart[nearest] < SAME_SHARE * width:
                looks[i] = nearest
                continue
        looks[i] = len(first)
        first.append(i)
    return looks


def _table(views: Sequence[View]) -> Array:
    """Pixels of every corner that any view has, (views, corners, 2), NaN where one lacks it; in an
    order that a half turn of the board turns round."""
    places = np.round(np.concatenate([view.points[:, :2] for view in views]), _DIGITS)
    corners, index = np.unique(places, axis=0, return_inverse=True)
    table = np.full((len(views), len(corners), 2), np.nan)
    view = np.repeat(np.arange(len(views)), [len(view) for view in views])
    table[view, index.reshape(-1)] = np.concatenate([view.pixels for view in views])
    return table


def _ways(pixels: Array) -> tuple[Array, Array]:
    """A view's corners, and those of it read from the other end."""
    return pixels, pixels[::-1]


def _apart(others: Array, pixels: Array) -> Array:
    """RMS distance of the corners (c, 2) from the same ones of other views (v, c, 2); infinite
    where they have too few in common."""
    squares = np.sum((others - pixels) ** 2, axis=-1)
    common = np.isfinite(squares)
    count = common.sum(axis=1)
    total = np.where(common, squares, 0.0).sum(axis=1)
    return np.where(count >= FEWEST_CORNERS, np.sqrt(total / np.maximum(count, 1)), np.inf)
