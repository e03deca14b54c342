"""Where on a grid of corners a board lies: which of the grid's corners are which of the board's.

A grid may have chance corners beside a board, run on over a second one, or lack lines that are
hidden or outside the picture. So every place of the board on it is weighed: by the corners that
would then be seen, by those that would be missing though they are in view, and by those beside the
board that should not be there.
"""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from trigpoint.edge.registration.appearance import Appearance
from trigpoint.edge.registration.planar_fit import PlanarFit
from trigpoint.geometry.rotation import Array

from .grid import Grid
from .tuning import TUNING


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """A board on a grid. `ids`: (n,) of the board's corners; `pixels`: (n, 2) where they are;
    `rest`: the grid's other corners; `score`: corners for it less those against it."""

    look: Appearance
    ids: np.ndarray
    pixels: Array
    rest: Grid
    score: int


@dataclass(frozen=True, slots=True)
class _Window:
    """A place of a board on a grid: its first place and its extent. `count`: of its corners that
    are seen; `score`: those less the missing ones and those beside it."""

    score: int
    count: int
    first: tuple[int, int]
    extent: tuple[int, int]


def placed(
    grid: Grid, look: Appearance, size: tuple[int, int], fit_of: Callable[[], PlanarFit | None]
) -> Placement | None:
    """The best place of a board on a grid; None where it shows too little of it, or leaves open
    where the board lies.

    `size`: of the picture; `fit_of`: from the grid's places to pixels, asked where corners are
    missing that may lie outside of the picture.
    """
    columns, rows = look.face.columns - 1, look.face.rows - 1
    enough, whole = TUNING.least_share * look.face.corner_count, look.face.corner_count
    extents = {(columns, rows), (rows, columns)}
    field = _Field.of(grid, max(columns, rows))
    best = field.windows(extents)
    if best[0].count < enough:
        return None
    if best[0].score < whole:
        fit = fit_of()
        if fit is None:
            return None
        field = field.within(fit, size)
        best = field.windows(extents)
    if best[0].count < enough or best[1].score > best[0].score - TUNING.least_lead:
        return None
    first, extent = best[0].first, best[0].extent
    inside = np.all((grid.places >= first) & (grid.places < np.add(first, extent)), axis=1)
    board = grid.only(inside)
    if field.shows_an_end(board.places, best[0]):
        return None
    ids = _numbered(board, board.places - first, extent, look)
    if ids is None:
        return None
    return Placement(look, ids, board.pixels, grid.only(~inside), best[0].score)


@dataclass(frozen=True, slots=True, eq=False)
class _Field:
    """The places about a grid, from place `low` on, (h, w) of 1 and 0: which are seen, and which
    are missing though the picture has them."""

    low: np.ndarray
    seen: np.ndarray
    missing: np.ndarray

    @classmethod
    def of(cls, grid: Grid, reach: int) -> "_Field":
        """All that are not seen are missing; `reach`: how far beyond the grid."""
        low = grid.places.min(axis=0) - reach
        across, down = grid.places.max(axis=0) + reach + 1 - low
        seen = np.zeros((down, across), np.float32)
        x, y = (grid.places - low).T
        seen[y, x] = 1
        return cls(low, seen, 1 - seen)

    def within(self, fit: PlanarFit, size: tuple[int, int]) -> "_Field":
        """Missing are those alone that the picture has, by the fit."""
        down, across = self.seen.shape
        every = np.stack(np.meshgrid(np.arange(across), np.arange(down)), axis=-1) + self.low
        pixels = fit.project(every.reshape(-1, 2).astype(float)).reshape(down, across, 2)
        limit = np.array(size) - 1 - TUNING.margin_px
        inside = np.all((pixels > TUNING.margin_px) & (pixels < limit), axis=-1)
        return _Field(self.low, self.seen, self.missing * inside)

    def windows(self, extents: set[tuple[int, int]]) -> list[_Window]:
        """The best places of boards of these extents, the best first: at least two."""
        found: list[_Window] = []
        for extent in extents:
            found += _best_of(self.seen, self.missing, extent, self.low)
        return sorted(found, key=lambda window: window.score, reverse=True)

    def shows_an_end(self, places: np.ndarray, window: _Window) -> bool:
        """Whether what is seen of a window, `places` (n, 2), ends at a line that most of the next
        one is missing after: another board's end, or one of a board that leaves its place open."""
        x, y = np.subtract(window.first, self.low)
        missing = self.missing[y : y + window.extent[1], x : x + window.extent[0]]
        places = places - window.first
        for axis in (0, 1):
            lines = missing.mean(axis=axis)  # of the lines across that axis
            low, high = int(places[:, axis].min()), int(places[:, axis].max())
            beyond = [*lines[max(low - 1, 0) : low], *lines[high + 1 : high + 2]]
            if any(share > TUNING.most_missing for share in beyond):
                return True
        return False


def keeps_its_place(
    look: Appearance, ids: np.ndarray, pixels: Array, fit: PlanarFit, size: tuple[int, int]
) -> bool:
    """Whether corners `ids` (n,) at `pixels` (n, 2), measured, still leave no doubt which they are:
    some that spoke for the place may have turned out to be none."""
    face = look.face
    places = np.stack([ids % (face.columns - 1), ids // (face.columns - 1)], axis=-1).astype(int)
    is_dark = (places.sum(axis=1) % 2 == 0) ^ face.inverted
    scaled = fit.scaled(face.square)
    again = placed(Grid(places, pixels, is_dark), look, size, lambda: scaled)
    return again is not None and len(again.ids) == len(ids)


def _best_of(
    seen: np.ndarray, missing: np.ndarray, extent: tuple[int, int], low: np.ndarray
) -> list[_Window]:
    """The two best places of a board of one extent."""
    count, lacking = _sums(seen, *extent), _sums(missing, *extent)
    # The window with all that is beside the board begins one place before.
    beside = np.zeros_like(count)
    beside[1:-1, 1:-1] = _sums(seen, extent[0] + 2, extent[1] + 2) - count[1:-1, 1:-1]
    score = np.rint(count - lacking - beside).astype(int)
    best = np.argsort(-score, axis=None, kind="stable")[:2]
    return [
        _Window(
            int(score[top, left]),
            round(float(count[top, left])),
            (int(left + low[0]), int(top + low[1])),
            extent,
        )
        for top, left in zip(*np.unravel_index(best, score.shape), strict=True)
    ]


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
    at the top left is dark, or light on an inverted board; of two that do, the one more
    upright in the picture is taken.
    """
    columns, rows = look.face.columns - 1, look.face.rows - 1
    width, height = extent
    best, uprightness = None, -np.inf
    for quarters in range(4):
        is_dark = _top_left_is_dark(grid, places, quarters)
        if (width, height) == (columns, rows) and is_dark is not look.face.inverted:
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
