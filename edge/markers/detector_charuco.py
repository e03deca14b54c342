"""Finds ChArUco boards: markers say which board and where, its corners are then measured.

One search for quadrilaterals serves all boards of a picture. A board's plane, fitted to its
markers, says where every corner must be; each is registered with what is printed there.
"""

from collections.abc import Sequence

from trigpoint.edge.registration.appearance import Appearance
from trigpoint.edge.registration.printed_pattern import charuco_layout
from trigpoint.site.target import Pattern

from .marked_board import MarkedBoard
from .marked_search import MarkedSearch


class CharucoDetector(MarkedSearch):
    """Finds every ChArUco board among the given looks.

    Raises TargetError for an unknown dictionary.
    """

    def __init__(self, looks: Sequence[Appearance]) -> None:
        own = [look for look in looks if look.face.pattern is Pattern.CHARUCO]
        super().__init__([MarkedBoard.of(look, charuco_layout(look.face)) for look in own], looks)
