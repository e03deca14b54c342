"""Finds checkerboards: X corners, joined into grids, matched to the boards' extents.

Our own search, since OpenCV's finders take 50 to 180 ms where no board is in view and have run for
minutes on near-black pictures. A grid is grown and judged by its neighbourhoods (`grid`),
the board's place on it by the corners it shows (`placement`), and whether a board is there by its
squares (`evidence`): nothing assumes a lens, or flat paper.
"""

from collections import deque
from collections.abc import Sequence

import cv2
import numpy as np
from msgspec import Struct

from trigpoint.edge.image.region import Region
from trigpoint.edge.image.time_limit import IsOver, never
from trigpoint.edge.registration.appearance import Appearance
from trigpoint.edge.registration.corner_pattern import CornerPattern
from trigpoint.edge.registration.finder import FaceFinder
from trigpoint.edge.registration.measurement import (
    Located,
    Measured,
    in_view,
    measured,
    placed_again,
)
from trigpoint.edge.registration.planar_fit import PlanarFit
from trigpoint.edge.registration.plane_fitting import settled_fit
from trigpoint.geometry.rotation import Array
from trigpoint.site.target import Face, Pattern

from .evidence import weighed
from .grid import LEAST_CORNERS, Grid, GridSearch
from .misdescribed import unexpected
from .placement import Placement, keeps_its_place, placed
from .tuning import TUNING


class CheckerboardDetector(FaceFinder):
    """Finds every checkerboard among the given looks."""

    def __init__(self, looks: Sequence[Appearance]) -> None:
        looks = [look for look in looks if look.face.pattern is Pattern.CHECKERBOARD]
        self._looks = tuple(looks)
        self._unexpected = unexpected(looks)
        self._lines: dict[Appearance, str] = {}
        extents = [(look.face.columns - 1, look.face.rows - 1) for look in looks]
        self._longest = max(max(extent) for extent in extents)
        self._least = min(TUNING.least_share * width * height for width, height in extents)
        self._most = TUNING.most_boards_joined * max(width * height for width, height in extents)
        self._searches = GridSearch(), GridSearch()
        for look in looks:  # drawn now, so that the first picture need not wait for it
            CornerPattern.of(look.face)

    def locate(
        self, grey: np.ndarray, is_over: IsOver, within: Region | None = None
    ) -> list[Located]:
        """The boards in a picture, or those in a part of it whose corners are joined at once; a
        second look at half the size is for blurred ones."""
        whole, half = self._searches
        if within:
            corners, source = whole.take(within.of(grey)), _Source(grey, within, 1)
            return self._search(whole, corners, source, _Allowance(is_over, 0))
        everything = Region.whole(grey)
        source = _Source(grey, everything, 1)
        found = self._search(whole, whole.take(grey), source, _Allowance(is_over))
        if not found and min(grey.shape) >= 64 and not is_over():
            source = _Source(grey, everything, 2)
            found = self._search(half, half.take_half(whole), source, _Allowance(is_over))
        for board in found:
            self._lines.pop(board.look, None)
        self.misdescribed = tuple(self._lines.values())
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
        so those must be there, or where the picture cuts them off, the others must leave no doubt.
        """
        face = last.look.face
        grey = _shown(grey, face)
        pattern = CornerPattern.of(face)
        if not is_in_view(grey, face, fit):
            return None
        place = placed_again(grey, pattern, fit, reach_px=reach_px)
        if place is None or is_over():
            return None
        there, is_rough = place
        if there is not fit and not is_in_view(grey, face, there):
            return None
        found = measured(
            grey,
            pattern,
            there,
            blur=last.found.blur,
            is_rough=is_rough,
            last=last.found.corners,
            least_again=TUNING.least_again,
        )
        if found is None or not _is_there(grey, face, found):
            return None
        is_sure = there is fit or keeps_its_place(last.look, found, (grey.shape[1], grey.shape[0]))
        return Located(last.look, found) if is_sure else None

    def _search(
        self, search: GridSearch, corners: int, source: "_Source", allowance: "_Allowance"
    ) -> list[Located]:
        """The boards found among so many corners of what was made of a picture, measured in that
        itself."""
        is_over = allowance.is_over
        if corners < self._least or is_over():
            return []
        found: list[Located] = []
        joined = search.grids(TUNING.most_grids)
        waiting = deque(grid for grid in joined if len(grid) <= self._most)
        for _ in range(TUNING.most_grids):
            if not waiting or is_over():
                break
            grid = waiting.popleft()
            board = self._board_of(grid, search, source, allowance)
            if board is None:
                self._look_for_unexpected(grid, source, is_over)
                continue
            if len(board.rest) >= max(self._least, LEAST_CORNERS):
                waiting.append(board.rest)
            sighting = _measured(board, source, is_over)
            if sighting and not any(sighting.found.is_near(other.found) for other in found):
                found.append(sighting)
                self._expect_no_other(sighting.look)  # it is described as it is
        return found

    def _board_of(
        self, grid: Grid, search: GridSearch, source: "_Source", allowance: "_Allowance"
    ) -> Placement | None:
        """The board that a grid is, grown where it is not whole; None where it is none."""
        if len(grid) < TUNING.least_filled * grid.extent[0] * grid.extent[1]:
            return None
        grid = grid.cleaned()
        board = self._placed(grid, source)
        if board is None or len(board.ids) < TUNING.least_grown * board.look.face.corner_count:
            if not allowance.may("grow"):
                return board
            board = self._placed(search.grown(grid, self._longest), source) or board
        return board

    def _placed(
        self, grid: Grid, source: "_Source", looks: Sequence[Appearance] = ()
    ) -> Placement | None:
        """The best of these looks' best places on a grid, of all expected ones where none are
        given."""
        if len(grid) < self._least:
            return None
        return placed(grid, looks or self._looks, source.size)

    def _look_for_unexpected(self, grid: Grid, source: "_Source", is_over: IsOver) -> None:
        """Note where a grid is a board that may be meant by one of the looks; each look is noted
        once, and then not asked for any more."""
        looks = list(self._unexpected)
        if not looks or is_over():
            return
        board = self._placed(grid.cleaned(), source, looks)
        if board is None or _measured(board, source, is_over) is None:
            return
        described, line = self._unexpected[board.look]
        self._lines[described] = line
        self._expect_no_other(described)

    def _expect_no_other(self, described: Appearance) -> None:
        """Look no more for what may be meant by a look."""
        self._unexpected = {
            other: meant for other, meant in self._unexpected.items() if meant[0] != described
        }


class _Source(Struct, frozen=True, eq=False):
    """What a searched picture was made of: a part of `grey`, `step` times smaller."""

    grey: np.ndarray
    part: Region
    step: int

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of what was made."""
        width, height = self.part.right - self.part.left, self.part.bottom - self.part.top
        return -(-width // self.step), -(-height // self.step)

    def pixels(self, small: Array) -> Array:
        """Where pixels (n, 2) of what was made lie in `grey`; halved, (x, y) is (2x, 2y)."""
        return small * self.step + self.part.corner


class _Allowance:
    """What one search may still do, and until when; `share`: 0 where nothing that takes long."""

    def __init__(self, is_over: IsOver, share: int = 1) -> None:
        self.is_over = is_over
        self._left = {"grow": share * TUNING.most_grown}

    def may(self, what: str) -> bool:
        """Whether to do that with one more grid; asked once for each."""
        self._left[what] -= 1
        return self._left[what] >= 0 and not self.is_over()


def _measured(board: Placement, source: "_Source", is_over: IsOver) -> Located | None:
    """The sighting with sub-pixel corners of the full picture, wild ones dropped; None where it is
    no board after all, or the time is over."""
    if is_over():
        return None
    face = board.look.face
    grey = _shown(source.grey, face)
    points, size = face.corners[board.ids, :2], (grey.shape[1], grey.shape[0])
    starts = np.full((face.corner_count, 2), np.nan)
    starts[board.ids] = pixels = source.pixels(board.pixels)
    fit = settled_fit(points, pixels, size, TUNING.enough_px)
    if fit is None:
        return None
    found = measured(grey, CornerPattern.of(face), fit, starts=starts)
    if found is None or len(found.corners) < TUNING.least_share * face.corner_count:
        return None
    if not keeps_its_place(board.look, found, size):
        return None
    return Located(board.look, found) if _is_there(grey, face, found) else None


def _is_there(grey: np.ndarray, face: Face, found: Measured) -> bool:
    """Whether the squares say that a board is where it was measured."""
    return weighed(grey, face, found.fit, found.corners, found.pixels).is_board


def _shown(grey: np.ndarray, face: Face) -> np.ndarray:
    """The picture in which a face is as it is when it is not inverted."""
    return cv2.bitwise_not(grey) if face.inverted else grey


def is_in_view(grey: np.ndarray, face: Face, fit: PlanarFit) -> bool:
    """Whether enough corners are in the picture at all: cheaper than to measure a board that is
    leaving it."""
    seen = in_view(fit, CornerPattern.of(face).points, (grey.shape[1], grey.shape[0]))
    return seen >= TUNING.least_share * face.corner_count
