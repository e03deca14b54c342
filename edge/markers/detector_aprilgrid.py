"""Finds AprilGrids: tags say which grid and where, their corners are then measured.

Corner ids are 4 · tag + corner, corners clockwise from the tag's top left, by the contract.
"""

from collections.abc import Sequence

from trigpoint.edge.registration.appearance import Appearance

from .marked_board import MarkedBoard
from .marked_search import MarkedSearch


class AprilGridDetector(MarkedSearch):
    """Finds every AprilGrid of the given looks; raises TargetError for an unknown dictionary."""

    def __init__(self, looks: Sequence[Appearance]) -> None:
        layouts = [look.face.corners[:, :2].reshape(-1, 4, 2) for look in looks]
        boards = [MarkedBoard.of(look, at) for look, at in zip(looks, layouts, strict=True)]
        super().__init__(boards)
