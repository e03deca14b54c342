"""What finds the faces of one pattern."""

from typing import Protocol

import numpy as np

from trigpoint.edge.image.region import Region
from trigpoint.edge.image.time_limit import IsOver

from .measurement import Located
from .planar_fit import PlanarFit


class FaceFinder(Protocol):
    """Finds the faces of one pattern in grey pictures, (height, width) uint8.

    `misdescribed`: what was seen so far that the target file describes wrongly, each once, a line
    with what to write.
    """

    misdescribed: tuple[str, ...] = ()

    def locate(
        self, grey: np.ndarray, is_over: IsOver, within: Region | None = None
    ) -> list[Located]:
        """The faces in a picture, or those that show plainly in a part of it, at a third of the
        time; those found so far where `is_over` becomes true."""
        ...

    def follow(
        self,
        grey: np.ndarray,
        last: Located,
        fit: PlanarFit,
        *,
        reach_px: float,
        is_over: IsOver = ...,
    ) -> Located | None:
        """A face that was found before and now lies where `fit` has it, to a pixel, or up to
        `reach_px` beside that; None where not, or where `is_over` becomes true before."""
        ...
