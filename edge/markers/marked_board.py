"""A look with markers, and how a group of its markers becomes a sighting."""

from functools import lru_cache

import numpy as np
from msgspec import Struct

from trigpoint.edge.image.time_limit import IsOver, never
from trigpoint.edge.registration.appearance import Appearance
from trigpoint.edge.registration.corner_pattern import CornerPattern
from trigpoint.edge.registration.measurement import (
    LEAST_CORNERS,
    Measured,
    measured,
    placed_again,
)
from trigpoint.edge.registration.planar_fit import PlanarFit
from trigpoint.edge.registration.plane_fitting import settled_fit
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.samples import median
from trigpoint.site.target import Face, Pattern

from .distances import chebyshev
from .marker_groups import MarkerGroup
from .markers import MarkerReader

# A board's markers, looked at where its corners put them, must match so well on the mean; one, two
# or three alone must do better, since foreign markers match by chance.
LEAST_AGREEMENT = 0.5
# Of the corners that were seen last and are in view, how many must be seen again: where fewer look
# as printed the fit has gone astray, and a search finds the board anew.
LEAST_AGAIN = 0.5
# Those that led to a board match better still where its measured corners put them: of moving boards
# 0.9; tags with a border of one cell, read as such of two, 0.66.
LEAST_OWN_AGREEMENT = 0.75
# Markers' corners that are all so near their plane need no lens, pixels.
ENOUGH_PX = 2.0
# Corners that scatter so much were measured from too far off: they are measured again, pixels.
MOST_SCATTER_PX = 0.04
_LEAST_OF_FEW = {1: 0.8, 2: 0.7, 3: 0.6}


class MarkedBoard(Struct, frozen=True, eq=False):
    """`layout`: (m, 4, 2) corners of the markers in the face frame by number, metres, clockwise
    from the marker's own top left; `variant`: which of the ways to print the look this is;
    `least_markers`: how many must agree on it; `finer`: the same where the picture shows more."""

    look: Appearance
    layout: Array
    pattern: CornerPattern
    variant: int = 0
    least_markers: int = 1
    finer: "MarkedBoard | None" = None

    @classmethod
    def of(cls, look: Appearance, layout: Array) -> "MarkedBoard":
        """The board of a look whose markers lie so."""
        return cls(look, layout, CornerPattern.of(look.face))

    @property
    def face(self) -> Face:
        """One of the faces that look so."""
        return self.look.face

    def locate(
        self, grey: np.ndarray, group: MarkerGroup, reader: MarkerReader, is_over: IsOver = never
    ) -> Measured | None:
        """The corners that a group of markers leads to; None where the picture denies it, or the
        time is over."""
        size = (grey.shape[1], grey.shape[0])
        layout = self.layout[group.numbers].reshape(-1, 2)
        fit = settled_fit(layout, group.corners.reshape(-1, 2), size, ENOUGH_PX)
        if fit is None or is_over():
            return None
        found = measured(grey, self.pattern, fit, is_rough=True)
        if found is not None and found.sigma > MOST_SCATTER_PX and not is_over():
            found = measured(grey, self.pattern, found.fit, is_rough=True)
        if found is None or len(found.corners) < self._least_corners(len(group.numbers)):
            return None
        quads = self._placed(found.fit)
        scores = reader.agreement(grey, self.face, quads, np.arange(len(quads)))
        own = scores[group.numbers].mean()
        if own < max(LEAST_OWN_AGREEMENT, _LEAST_OF_FEW.get(len(group.numbers), 0.0)):
            return None
        touch = _touching(self)[:, found.corners].any(axis=1)
        beside = scores[_are_inside(grey, quads) & touch]
        least = _LEAST_OF_FEW.get(len(beside), LEAST_AGREEMENT)
        return found if len(beside) == 0 or beside.mean() >= least else None

    def _placed(self, fit: PlanarFit) -> Array:
        """The markers' corners in the picture, (m, 4, 2)."""
        return fit.project(self.layout.reshape(-1, 2)).reshape(-1, 4, 2)

    def _least_corners(self, markers: int) -> int:
        """How many corners must be seen beside so many markers: a tag alone has four."""
        few = markers > 1 and self.face.pattern is Pattern.CHARUCO
        return 1 if few else LEAST_CORNERS

    def follow(
        self,
        grey: np.ndarray,
        last: Measured,
        fit: PlanarFit,
        reader: MarkerReader,
        *,
        reach_px: float,
        is_over: IsOver = never,
    ) -> Measured | None:
        """The corners of a board that lies about where `fit` has it."""
        place = placed_again(grey, self.pattern, fit, reach_px=reach_px)
        if place is None or is_over():
            return None
        there, is_rough = place
        found = measured(
            grey,
            self.pattern,
            there,
            blur=last.blur,
            is_rough=is_rough,
            last=last.corners,
            least_again=LEAST_AGAIN,
        )
        if found is None:
            return None
        quads = self._placed(found.fit)
        numbers = np.flatnonzero(_are_inside(grey, quads))
        if len(numbers) == 0 or len(found.corners) < self._least_corners(len(numbers)):
            return None
        scores = reader.agreement(grey, self.face, quads[numbers], numbers)
        least = _LEAST_OF_FEW.get(len(numbers), LEAST_AGREEMENT)
        return found if median(scores) >= least else None


@lru_cache(1024)
def _touching(board: MarkedBoard) -> np.ndarray:
    """Which of a board's markers touch which of its corners, (m, corners)."""
    apart = chebyshev(board.layout.mean(axis=1), board.pattern.points)
    return apart < 0.75 * board.face.square


def _are_inside(grey: np.ndarray, quads: Array) -> np.ndarray:
    """Which quadrilaterals (m, 4, 2) lie wholly in the picture, (m,)."""
    return np.all((quads > 0) & (quads < np.array(grey.shape[::-1]) - 1), axis=(1, 2))
