"""Where on a grid of corners a board lies: which of the grid's corners are which of the board's.

A grid may have chance corners beside a board, run on over a second one, or lack lines that are
hidden or outside the picture. So every place of the board on it is weighed: by the corners that
would then be seen, by those that would be missing though they are in view, and by those beside the
board that should not be there.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from trigpoint.edge.registration.appearance import Appearance
from trigpoint.edge.registration.planar_fit import PlanarFit
from trigpoint.geometry.rotation import Array

from .grid import Grid

# Of a board's corners, how many must be seen.
LEAST_SHARE = 0.55
# By how many corners a place must be better than the next best one. A corner is seen on a board, or
# not seen elsewhere, nine times of ten: two of them are odds of 80.
LEAST_LEAD = 2
# Corners nearer to the picture's edge than this are not found.
_MARGIN_PX = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """A board on a grid. `ids`: (n,) of the board's corners; `pixels`: (n, 2) where they are;
    `rest`: the grid's other corners; `score`: corners for it less those against it."""

    look: Appearance
    ids: np.ndarray
    pixels: Array
    rest: Grid
    score: int


def placed(grid: Grid, look: Appearance, fit: PlanarFit, size: tuple[int, int]) -> Placement | None:
    """The best place of a board on a grid; None where it shows too little of it, or leaves open
    where the board lies. `fit`: from the grid's places to pixels; `size`: of the picture."""
    columns, rows = look.face.columns - 1, look.face.rows - 1
    best: list[tuple[int, int, tuple[int, int], tuple[int, int]]] = []
    for extent in {(columns, rows), (rows, columns)}:
        best += _places_of(grid, extent, fit, size)
    best.sort(key=lambda place: place[0], reverse=True)
    if not best or best[0][1] < LEAST_SHARE * look.face.corner_count:
        return None
    score, _, corner, extent = best[0]
    if len(best) > 1 and best[1][0] > score - LEAST_LEAD:
        return None
    inside = np.all((grid.places >= corner) & (grid.places < np.add(corner, extent)), axis=1)
    board = grid.only(inside)
    ids = _numbered(board, board.places - corner, extent, look)
    return ids if ids is None else Placement(look, ids, board.pixels, grid.only(~inside), score)


def _places_of(
    grid: Grid, extent: tuple[int, int], fit: PlanarFit, size: tuple[int, int]
) -> list[tuple[int, int, tuple[int, int], tuple[int, int]]]:
    """Score, count of corners seen, first place and extent of the best places of a board of that
    extent: the two that are best."""
    width, height = extent
    low = grid.places.min(axis=0) - (width, height)
    across, down = grid.places.max(axis=0) + (width, height) + 1 - low
    seen = np.zeros((down, across), np.float32)
    x, y = (grid.places - low).T
    seen[y, x] = 1
    every = np.stack(np.meshgrid(np.arange(across), np.arange(down)), axis=-1) + low
    pixels = fit.project(every.reshape(-1, 2).astype(float)).reshape(down, across, 2)
    in_view = np.all((pixels > _MARGIN_PX) & (pixels < np.array(size) - 1 - _MARGIN_PX), axis=-1)
    missing = ((seen == 0) & in_view).astype(np.float32)
    count, lacking = _sums(seen, width, height), _sums(missing, width, height)
    beside = _sums(seen, width + 2, height + 2)
    # The window that is wider begins one place before.
    beyond = np.zeros_like(count)
    beyond[1:-1, 1:-1] = beside
    beyond[1:-1, 1:-1] -= count[1:-1, 1:-1]
    score = np.rint(count - lacking - beyond).astype(int)
    flat = np.argsort(-score, axis=None, kind="stable")[:2]
    found = []
    for top, left in zip(*np.unravel_index(flat, score.shape), strict=True):
        first = (int(left + low[0]), int(top + low[1]))
        found.append((int(score[top, left]), round(float(count[top, left])), first, extent))
    return found


def _sums(values: np.ndarray, width: int, height: int) -> np.ndarray:
    """The sum over each window (height, width) by its first place."""
    total = cv2.integral(values)
    return (
        total[height:, width:]
        - total[:-height, width:]
        - total[height:, :-width]
        + total[:-height, :-width]
    )


def _numbered(
    grid: Grid, places: np.ndarray, extent: tuple[int, int], look: Appearance
) -> np.ndarray | None:
    """Corner ids (n,) of a grid at `places` of a window of the look's extent; None where its
    colours are another board's.

    Turns the window by quarters (never mirrors it) until it is as wide as the board and the square
    at the top left is dark; of two that do, the one more upright in the picture is taken.
    """
    columns, rows = look.face.columns - 1, look.face.rows - 1
    width, height = extent
    best, uprightness = None, -np.inf
    for quarters in range(4):
        if (width, height) == (columns, rows) and _top_left_is_dark(grid, places, quarters):
            upright = _uprightness(places, grid.pixels)
            if upright > uprightness:
                best, uprightness = places[:, 1] * columns + places[:, 0], upright
        # A quarter turn: the old y runs along the new x backwards.
        places = np.stack([height - 1 - places[:, 1], places[:, 0]], axis=-1)
        width, height = height, width
    return best


def _top_left_is_dark(grid: Grid, places: np.ndarray, quarters: int) -> bool:
    """Whether the square outside corner (0, 0) is dark in a grid turned by `quarters`.

    Colours alternate with each step and with each quarter turn; the majority of the corners votes.
    """
    flips = (places.sum(axis=1) + quarters) % 2 == 1
    return bool(np.mean(grid.is_dark ^ flips) > 0.5)


def _uprightness(places: np.ndarray, pixels: Array) -> float:
    """How far the grid's x runs to the picture's right and its y down."""
    centred = places - places.mean(axis=0)
    spread = pixels - pixels.mean(axis=0)
    across, down = centred.T @ spread
    return float(across[0] / np.linalg.norm(across) + down[1] / np.linalg.norm(down))
