"""One rigid board is in one place of a picture: of several, one is the board.

The others show it on a monitor, in a mirror or on a window pane: whole, sharp, and through more
than one lens. Which is the board, the lens of the other pictures tells.
"""

from collections.abc import Sequence

import numpy as np

from .calibration_fit import Placed
from .calibration_views import View


def rivals_of(views: Sequence[View]) -> list[list[int]]:
    """The indices of views that are the same board's in the same picture, where there are several,
    the largest in the picture first."""
    places: dict[object, list[int]] = {}
    for index, view in enumerate(views):
        if view.board is not None:
            places.setdefault((view.name, view.board), []).append(index)
    several = (same for same in places.values() if len(same) > 1)
    return [sorted(same, key=lambda i: -_size(views[i])) for same in several]


def losers_of(rivals: Sequence[Sequence[int]], placed: Sequence[Placed | None]) -> set[int]:
    """All rivals but those that the lens explains best."""
    losers: set[int] = set()
    for same in rivals:
        losers |= set(same) - {min(same, key=lambda i: off_px(placed[i]))}
    return losers


def off_px(placed: Placed | None) -> float:
    """How far a view's median corner is off, pixels; infinitely where it has no pose."""
    if placed is None:
        return np.inf
    return float(np.median(np.linalg.norm(placed.error, axis=1)))


def _size(view: View) -> float:
    return float(np.prod(np.ptp(view.pixels, axis=0)))
