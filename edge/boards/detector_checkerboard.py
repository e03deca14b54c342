"""Finds checkerboards: X corners, joined into grids, matched to the boards' extents.

Our own search, since OpenCV's finders take 50 to 180 ms where no board is in view and have run for
minutes on near-black pictures. A board counts as seen where its grid is complete in width and
height; corners may be missing, more of them where its outermost lines are seen and nothing of it
lies beyond (`partly_seen`).
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from trigpoint.edge.image.region import Region
from trigpoint.edge.image.sampling import sampled
from trigpoint.edge.image.time_limit import IsOver, never
from trigpoint.edge.image.workspace import Workspace
from trigpoint.edge.registration.appearance import Appearance
from trigpoint.edge.registration.finder import FaceFinder
from trigpoint.edge.registration.measurement import Located, Measured, measured, placed_again
from trigpoint.edge.registration.patches import CornerPattern
from trigpoint.edge.registration.planar_fit import PlanarFit, settled_fit
from trigpoint.geometry.rotation import Array
from trigpoint.target import Face

from .grid import Grid, find_grids
from .grid_growth import ENOUGH_PX, LEAST_SEED, cleaned, grown, largest_flat
from .partly_seen import LEAST_SHARE as LEAST_PARTLY
from .partly_seen import is_ended, is_partly_seen
from .saddles import Curvature, find_saddles

# Of a board's corners, how many must be seen where no more is asked of its borders.
LEAST_SHARE = 0.75
# The same along one side of the board, and how large a step from square to square must be there, of
# the board's contrast.
LEAST_ALTERNATING_BORDER = 0.7
LEAST_STEP = 0.25
# Of the corners that were seen last, how many must be seen where a board is followed.
LEAST_AGAIN = 0.85
# Of a grid as it was joined, how many corners must lie on one plane; chance grids of noise do not.
LEAST_KEPT = 0.6
# Of the places of its extent, how many a joined grid must fill; chance grids wander.
LEAST_FILLED = 0.4
# An outermost row or column with fewer of its corners is no part of the board.
LEAST_BORDER_SHARE = 0.34
MOST_GRIDS = 16
# How many of a picture's grids are held against a lens where no plane alone explains them, are made
# whole where they are not, and are taken apart; the largest come first.
MOST_BENT = 6
MOST_GROWN = 3
MOST_PARTED = 4
# A grid of more corners than so many boards have is a floor or a wall.
MOST_BOARDS_JOINED = 4
# Of the pairs of neighbouring squares, how many must be light and dark the right way round.
LEAST_ALTERNATING = 0.85


class CheckerboardDetector(FaceFinder):
    """Finds every checkerboard of the given looks."""

    def __init__(self, looks: Sequence[Appearance]) -> None:
        self._looks = tuple(looks)
        extents = [(look.face.columns - 1, look.face.rows - 1) for look in looks]
        self._largest = (max(max(e) for e in extents), max(min(e) for e in extents))
        self._least = min(LEAST_PARTLY * width * height for width, height in extents)
        self._most = MOST_BOARDS_JOINED * max(width * height for width, height in extents)
        self._spaces = {1: Workspace(), 2: Workspace()}

    def locate(
        self, grey: np.ndarray, is_over: IsOver, within: Region | None = None
    ) -> list[Located]:
        """The boards in a picture, or those in a part of it whose corners are joined at once; a
        second look at half the size is for blurred ones."""
        if within:
            return self._search(within.of(grey), _Source(grey, within, 1), _Allowance(is_over, 0))
        whole = Region.whole(grey)
        found = self._search(grey, _Source(grey, whole, 1), _Allowance(is_over))
        if not found and min(grey.shape) >= 64 and not is_over():
            height, width = grey.shape
            half = self._spaces[2].array("half", ((height + 1) // 2, (width + 1) // 2), np.uint8)
            small = cv2.pyrDown(grey, dst=half)
            found = self._search(small, _Source(grey, whole, 2), _Allowance(is_over))
        return found

    def follow(
        self,
        grey: np.ndarray,
        last: Located,
        fit: PlanarFit,
        *,
        reach_px: float,
        is_over: IsOver = never,
    ) -> Located | None:
        """A board that was found before and now lies about where `fit` has it.

        Moved by a square each way, or by two, a board matches itself but for its outermost squares,
        so those must be there.
        """
        face = last.look.face
        pattern = CornerPattern.of(face)
        place = placed_again(grey, pattern, fit, reach_px=reach_px)
        if place is None or not may_be_bordered(grey, face, place[0]):
            return None
        there, is_rough = place
        blur = last.found.blur
        found = measured(grey, pattern, there, blur=blur, is_rough=is_rough, is_over=is_over)
        if found is None or len(found.corners) < LEAST_AGAIN * len(last.found.corners):
            return None
        is_there = alternates(grey, face, found.fit) and is_bordered(grey, face, found.fit)
        return Located(last.look, found) if is_there else None

    def _search(
        self, small: np.ndarray, source: "_Source", allowance: "_Allowance"
    ) -> list[Located]:
        """The boards found in what was made of a picture, measured in that itself."""
        is_over = allowance.is_over
        curvature = Curvature.of(small, self._spaces[source.step])
        saddles = find_saddles(curvature)
        if len(saddles) < min(self._least, LEAST_SEED) or is_over():
            return []
        found: list[Located] = []
        joined = find_grids(saddles)[:MOST_GRIDS]
        waiting = deque(grid for grid in joined if len(grid) <= self._most)
        for _ in range(MOST_GRIDS):
            if not waiting or is_over():
                break
            grid = waiting.popleft()
            board = self._board_of(grid, curvature, allowance)
            sighting = _measured(*board, source, is_over) if board else None
            if sighting is None:
                waiting.extend(self._parts(grid, small, allowance))
            elif not any(_same_place(sighting, other) for other in found):
                found.append(sighting)
        return found

    def _parts(self, grid: Grid, small: np.ndarray, allowance: "_Allowance") -> list[Grid]:
        """A grid that is no board, taken apart where it runs over two planes."""
        if len(grid) < 2 * LEAST_SEED or not allowance.may("part"):
            return []
        flat = largest_flat(grid, (small.shape[1], small.shape[0]))
        if flat.all() or flat.sum() < LEAST_SEED:
            return []
        return [grid.only(flat), grid.only(~flat)]

    def _board_of(
        self, grid: Grid, curvature: Curvature, allowance: "_Allowance"
    ) -> tuple[Grid, Appearance] | None:
        """The board that a grid is, grown where it is not whole; None where it is none."""
        size = (curvature.smooth.shape[1], curvature.smooth.shape[0])
        least = min(self._least, LEAST_SEED)
        whole = len(grid)
        if whole < max(least, LEAST_FILLED * grid.extent[0] * grid.extent[1]):
            return None
        grid = cleaned(grid, size, allowance.may_bend)
        if len(grid) < max(least, LEAST_KEPT * whole):
            return None
        look = self._look_of(grid)
        if look is None:
            # Chance corners beside a whole board.
            grid = trimmed(grid)
            look = self._look_of(grid)
        if look is None or len(grid) < look.face.corner_count:
            if allowance.may("grow"):
                grid = trimmed(grown(grid, curvature, self._largest, allowance.may_bend))
            look = self._look_of(grid)
        return (grid, look) if look else None

    def _look_of(self, grid: Grid) -> Appearance | None:
        for look in self._looks:
            extent = (look.face.columns - 1, look.face.rows - 1)
            enough = len(grid) >= LEAST_PARTLY * look.face.corner_count
            fits = grid.extent in (extent, extent[::-1])
            if enough and fits and _numbered(grid, look) is not None:
                return look
        return None


@dataclass(frozen=True, slots=True, eq=False)
class _Source:
    """What a searched picture was made of: a part of `grey`, `step` times smaller."""

    grey: np.ndarray
    part: Region
    step: int

    def pixels(self, small: Array) -> Array:
        """Where pixels (n, 2) of what was made lie in `grey`; pyrDown's (x, y) is (2x, 2y)."""
        return small * self.step + self.part.corner


class _Allowance:
    """What one search may still do, and until when; `share`: 0 where nothing that takes long."""

    def __init__(self, is_over: IsOver, share: int = 1) -> None:
        self.is_over = is_over
        self._left = {"bend": MOST_BENT, "grow": share * MOST_GROWN, "part": share * MOST_PARTED}

    def may_bend(self) -> bool:
        """Whether to hold one more grid against a lens."""
        return self.may("bend")

    def may(self, what: str) -> bool:
        """Whether to bend, grow or part one more grid; asked once for each."""
        self._left[what] -= 1
        return self._left[what] >= 0 and not self.is_over()


def trimmed(grid: Grid) -> Grid:
    """The grid without outermost rows and columns that hardly have corners."""
    while len(grid) > 0:
        keep = np.ones(len(grid), dtype=bool)
        extent = grid.extent
        for axis in (0, 1):
            for end in (grid.places[:, axis].min(), grid.places[:, axis].max()):
                on_end = grid.places[:, axis] == end
                if on_end.sum() < LEAST_BORDER_SHARE * extent[1 - axis]:
                    keep &= ~on_end
        if keep.all():
            break
        grid = grid.only(keep)
    return grid


def _numbered(grid: Grid, look: Appearance) -> np.ndarray | None:
    """Corner ids (n,) of a grid of the look's extent; None where its colours are another board's.

    Turns the grid by quarters (never mirrors it) until it is as wide as the board and the square at
    the top left is dark; of two that do, the one more upright in the picture is taken.
    """
    columns, rows = look.face.columns - 1, look.face.rows - 1
    places = grid.places - grid.places.min(axis=0)
    best, uprightness = None, -np.inf
    for quarters in range(4):
        width, height = places.max(axis=0) + 1
        if (width, height) == (columns, rows) and _top_left_is_dark(grid, places, quarters):
            upright = _uprightness(places, grid.pixels)
            if upright > uprightness:
                best, uprightness = places[:, 1] * columns + places[:, 0], upright
        # A quarter turn: the old y runs along the new x backwards.
        places = np.stack([places[:, 1].max() - places[:, 1], places[:, 0]], axis=-1)
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


def _measured(grid: Grid, look: Appearance, source: "_Source", is_over: IsOver) -> Located | None:
    """The sighting with sub-pixel corners of the full picture, wild ones dropped; None also where
    the time is over."""
    ids = _numbered(grid, look)
    if ids is None or is_over():
        return None
    grey = source.grey
    points, size = look.face.corners[ids, :2], (grey.shape[1], grey.shape[0])
    fit = settled_fit(points, source.pixels(grid.pixels), size, ENOUGH_PX)
    found = measured(grey, CornerPattern.of(look.face), fit, is_over=is_over) if fit else None
    return Located(look, found) if found and _is_board(grey, look.face, found) else None


def _is_board(grey: np.ndarray, face: Face, found: Measured) -> bool:
    """Whether enough is seen of a board: nearly all of it, or a part that leaves no doubt."""
    is_whole = len(found.corners) >= LEAST_SHARE * face.corner_count
    if is_whole and alternates(grey, face, found.fit) and is_ended(grey, face, found.fit):
        return True
    is_told = is_partly_seen(grey, face, found.fit, found.corners)
    return is_told and is_bordered(grey, face, found.fit)


def alternates(grey: np.ndarray, face: Face, fit: PlanarFit) -> bool:
    """Whether the squares inside the corners are dark and light in turn, the first one dark."""
    x, y = np.meshgrid(np.arange(face.columns - 2), np.arange(face.rows - 2))
    centres = face.square * (np.stack([x, y], axis=-1) + 0.5)
    values = sampled(grey, fit.project(centres.reshape(-1, 2))).reshape(x.shape)
    # Square (0, 0) inside the corners is (1, 1) of the board: dark, like all of even x + y.
    rising = np.where((x + y) % 2 == 0, values, -values)
    across, down = rising[:, 1:] + rising[:, :-1], rising[1:] + rising[:-1]
    right = np.concatenate([across.reshape(-1), down.reshape(-1)]) < 0
    return bool(right.mean() >= LEAST_ALTERNATING) if len(right) else True


def is_bordered(grey: np.ndarray, face: Face, fit: PlanarFit) -> bool:
    """Whether the outermost squares of all four sides are dark and light in turn."""
    x, y = np.meshgrid(np.arange(face.columns) - 1, np.arange(face.rows) - 1)
    centres = face.square * (np.stack([x, y], axis=-1) + 0.5)
    values = sampled(grey, fit.project(centres.reshape(-1, 2))).reshape(x.shape)
    is_dark = (x + y) % 2 == 0
    contrast = values[~is_dark].mean() - values[is_dark].mean()
    rising = np.where(is_dark, values, -values)
    steps = [-(side[1:] + side[:-1]) > LEAST_STEP * contrast for side in _sides(rising)]
    return all(step.mean() >= LEAST_ALTERNATING_BORDER for step in steps)


def may_be_bordered(grey: np.ndarray, face: Face, fit: PlanarFit) -> bool:
    """Whether the outermost squares of all four sides are in the picture at all, by the corners
    between them: cheaper than to measure a board that is leaving it."""
    pixels = fit.project(face.corners[:, :2])
    inside = np.all((pixels >= 0) & (pixels <= np.array(grey.shape[::-1]) - 1), axis=1)
    sides = _sides(inside.reshape(face.rows - 1, face.columns - 1))
    return all(side.mean() >= LEAST_ALTERNATING_BORDER for side in sides)


def _sides(rows: np.ndarray) -> tuple[np.ndarray, ...]:
    """The outermost ones of what lies in rows and columns (r, c)."""
    return rows[0], rows[-1], rows[:, 0], rows[:, -1]


def _same_place(first: Located, second: Located) -> bool:
    """Whether two sightings are the same board, found from two grids."""
    centre = first.found.pixels.mean(axis=0) - second.found.pixels.mean(axis=0)
    spread = np.ptp(second.found.pixels, axis=0)
    return bool(np.all(np.abs(centre) < 0.25 * spread))
