"""Finds AprilGrids: tags say which grid and where, their corners are then measured.

Corner ids are 4 · tag + corner, corners clockwise from the tag's top left, by the contract. Whether
the tags stand upright by their dictionary, or on their heads as Kalibr's do, the way in which they
lie beside each other tells; a tag alone is taken as the target file's numbering says.
"""

from collections.abc import Sequence

import numpy as np
from msgspec.structs import replace

from trigpoint.edge.registration.appearance import Appearance
from trigpoint.edge.registration.corner_pattern import CornerPattern
from trigpoint.site.target import Pattern

from .marked_board import MarkedBoard
from .marked_search import MarkedSearch

# Tags that do not stand as the file has it are believed where they agree with each other.
_LEAST_OTHERWISE = 2


class AprilGridDetector(MarkedSearch):
    """Finds every AprilGrid among the given looks; raises TargetError for an unknown dictionary."""

    def __init__(self, looks: Sequence[Appearance]) -> None:
        own = [look for look in looks if look.face.pattern is Pattern.APRILGRID]
        boards = [_board(look, is_turned=is_turned) for look in own for is_turned in _ways_up(look)]
        has_squares = any(look.face.has_corner_squares for look in own)
        super().__init__(boards, looks, parts_touching=has_squares)


def _ways_up(look: Appearance) -> tuple[bool, ...]:
    """Whether the tags may stand on their heads, the likelier first."""
    face = look.face
    is_turned = face.has_turned_tags
    return (is_turned,) if face.tags_turned is not None else (is_turned, not is_turned)


def _board(look: Appearance, *, is_turned: bool) -> MarkedBoard:
    """A look with its tags one way up; finer, where corner squares are seen."""
    upright = look.face.corners[:, :2].reshape(-1, 4, 2)
    layout = np.roll(upright, 2, axis=1) if is_turned else upright
    plain, squared = (
        CornerPattern.of(replace(look.face, tags_turned=is_turned, corner_squares=squares))
        for squares in (False, True)
    )
    least = 1 if is_turned is look.face.has_turned_tags else _LEAST_OTHERWISE
    finer = MarkedBoard(look, layout, squared, 2 + is_turned, least)
    return MarkedBoard(look, layout, plain, int(is_turned), least, finer)
