"""Finds AprilGrids: tags say which grid and where, their corners are then measured.

Corner ids are 4 · tag + corner, corners clockwise from the tag's top left, by the contract.
"""

from collections.abc import Sequence

import numpy as np

from trigpoint.messages import FaceSighting

from .detector import Appearance
from .marked_board import MarkedBoard
from .marked_search import MarkedSearch
from .picture import as_grey


class AprilGridDetector:
    """Finds every AprilGrid of the given looks; raises TargetError for an unknown dictionary."""

    def __init__(self, looks: Sequence[Appearance]) -> None:
        layouts = [look.face.corners[:, :2].reshape(-1, 4, 2) for look in looks]
        boards = [MarkedBoard.of(look, at) for look, at in zip(looks, layouts, strict=True)]
        self._search = MarkedSearch(boards)

    def detect(self, picture: np.ndarray) -> tuple[FaceSighting, ...]:
        """The grids in a picture."""
        return self._search.search(as_grey(picture))
