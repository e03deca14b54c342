"""A look with markers, and how a group of its markers becomes a sighting."""

from dataclasses import dataclass

import numpy as np

from trigpoint.geometry.rotation import Array
from trigpoint.target import Face

from .detector import Appearance
from .marker_groups import MarkerGroup
from .markers import MarkerReader
from .measurement import LEAST_CORNERS, Measured, measured
from .patches import CornerPattern
from .planar_fit import PlanarFit, fit_plane

# A board's markers, looked at where its corners put them, must match so well on the mean.
LEAST_AGREEMENT = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class MarkedBoard:
    """`layout`: (m, 4, 2) corners of the markers in the face frame by number, metres."""

    look: Appearance
    layout: Array
    pattern: CornerPattern

    @classmethod
    def of(cls, look: Appearance, layout: Array) -> "MarkedBoard":
        """The board of a look whose markers lie so."""
        return cls(look, layout, CornerPattern.of(look.face))

    @property
    def face(self) -> Face:
        """One of the faces that look so."""
        return self.look.face

    def locate(self, grey: np.ndarray, group: MarkerGroup, reader: MarkerReader) -> Measured | None:
        """The corners that a group of markers leads to; None where the picture denies it."""
        size = (grey.shape[1], grey.shape[0])
        layout = self.layout[group.numbers].reshape(-1, 2)
        fit = fit_plane(layout, group.corners.reshape(-1, 2), size)
        found = measured(grey, self.pattern, fit, is_rough=True) if fit else None
        if found is None or (len(found.corners) < LEAST_CORNERS and len(group.numbers) < 2):
            return None
        return found if self.agrees(grey, found.fit, group.numbers, reader) else None

    def follow(
        self, grey: np.ndarray, last: Measured, fit: PlanarFit, reader: MarkerReader
    ) -> Measured | None:
        """The corners of a board that lies about where `fit` has it."""
        found = measured(grey, self.pattern, fit, blur=last.blur, is_rough=True)
        if found is None or len(found.corners) < LEAST_CORNERS:
            return None
        quads = found.fit.project(self.layout.reshape(-1, 2)).reshape(-1, 4, 2)
        inside = np.all((quads > 0) & (quads < np.array(grey.shape[::-1]) - 1), axis=(1, 2))
        numbers = np.flatnonzero(inside)
        if len(numbers) == 0:
            return None
        scores = reader.agreement(grey, self.face, quads[numbers], numbers)
        return found if np.median(scores) >= LEAST_AGREEMENT else None

    def agrees(
        self, grey: np.ndarray, fit: PlanarFit, numbers: np.ndarray, reader: MarkerReader
    ) -> bool:
        """Whether the markers `numbers`, where a fit puts them, are the board's."""
        quads = fit.project(self.layout[numbers].reshape(-1, 2)).reshape(-1, 4, 2)
        return bool(reader.agreement(grey, self.face, quads, numbers).mean() >= LEAST_AGREEMENT)
