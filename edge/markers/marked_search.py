"""The search that ChArUco boards and AprilGrids share: quadrilaterals, markers, boards."""

from collections.abc import Sequence

import cv2
import numpy as np

from trigpoint.edge.image.region import Region
from trigpoint.edge.image.time_limit import IsOver, never
from trigpoint.edge.registration.appearance import Appearance
from trigpoint.edge.registration.corner_pattern import CornerPattern
from trigpoint.edge.registration.finder import FaceFinder
from trigpoint.edge.registration.measurement import Located, Measured
from trigpoint.edge.registration.planar_fit import PlanarFit
from trigpoint.geometry.rotation import Array

from .contradictions import contradictions
from .corner_squares import refined
from .marked_board import MarkedBoard
from .marker_groups import MarkerGroup, group_markers
from .markers import reader_key, readers_for, whole_reader
from .misdescribed import MisdescribedBoards
from .quads import QuadFinder

# After so many groups of markers that the picture denied, the lighter ones are no boards either.
MOST_REFUSED = 3
# So many markers make a group that shows plainly.
LEAST_PLAIN = 2


class MarkedSearch(FaceFinder):
    """Finds boards with markers; one pass over the picture serves them all."""

    def __init__(
        self,
        boards: Sequence[MarkedBoard],
        looks: Sequence[Appearance],
        *,
        parts_touching: bool = False,
    ) -> None:
        """`looks`: all of the site; `parts_touching`: markers may touch other black things with
        their corners. Raises TargetError for an unknown or too small dictionary."""
        self._boards = tuple(boards)
        self._readers = readers_for([board.look.face for board in boards])
        self._whole = {key: whole_reader(*key) for key in self._readers}
        self._finder = QuadFinder(parts_touching=parts_touching)
        own = tuple(dict.fromkeys(board.look for board in boards))
        self._wrong = MisdescribedBoards(own, [look.face for look in looks])
        self._denied: list[Located] = []  # of the last picture
        self._compared: dict[Appearance, set[int]] = {}

    def locate(
        self, grey: np.ndarray, is_over: IsOver, within: Region | None = None
    ) -> list[Located]:
        """The boards in a grey picture, or those of some markers in a part of it; inverted ones
        are looked for in its negative."""
        self._denied.clear()
        found: list[Located] = []
        seen: dict[tuple[bool, bool], Array] = {}
        for inverted in (False, True):
            boards = [board for board in self._boards if board.look.face.inverted is inverted]
            if boards and not is_over():
                shown = cv2.bitwise_not(grey) if inverted else grey
                quads = self._finder.find(shown, is_over, within)
                seen[inverted, self._finder.parts_touching] = quads
                found += self._search(shown, quads, boards, is_over, LEAST_PLAIN if within else 1)
        # What is contradicted is not proven by the rest of it; another robot's board is no part.
        found = [
            board for board in found if not any(_overlap(board, other) for other in self._denied)
        ]
        for board in found:
            self._wrong.confirm(board.look)
        # Where a look is seen as the file has it, what is like it elsewhere does not deny the file.
        denied = {board.look for board in self._denied} - {board.look for board in found}
        if denied or not (found or within or is_over()):
            self._wrong.look(grey, denied, is_over, quads={} if within else seen)
        self.misdescribed = tuple(self._wrong.lines.values())
        return [board for board in found if board.look not in self._wrong.refused]

    def follow(
        self,
        grey: np.ndarray,
        last: Located,
        fit: PlanarFit,
        *,
        reach_px: float,
        is_over: IsOver = never,
    ) -> Located | None:
        """A board that was found before and now lies about where `fit` has it."""
        board = self._board_of(last)
        if board.look in self._wrong.refused:
            return None
        shown = cv2.bitwise_not(grey) if board.face.inverted else grey
        reader = self._readers[reader_key(board.face)]
        found = board.follow(shown, last.found, fit, reader, reach_px=reach_px, is_over=is_over)
        if found is None or (not is_over() and self._is_denied_by_more(shown, board, found)):
            return None
        self._wrong.confirm(board.look)
        return Located(board.look, found, last.variant)

    def _is_denied_by_more(self, grey: np.ndarray, board: MarkedBoard, found: Measured) -> bool:
        """Whether what came into view since a board was last held against the picture contradicts
        it: a board that drives in shows the part that does not agree last."""
        new = set(found.corners.tolist()) - self._compared.setdefault(board.look, set())
        return bool(new) and self._is_contradicted(grey, board, found, self._finder.find(grey))

    def _is_contradicted(
        self, grey: np.ndarray, board: MarkedBoard, found: Measured, quads: Array
    ) -> bool:
        self._compared.setdefault(board.look, set()).update(found.corners.tolist())
        reader = self._whole[reader_key(board.face)]
        return contradictions(grey, board, found, quads, reader).are_plain

    def _board_of(self, last: Located) -> MarkedBoard:
        """What a face was taken for."""
        boards = [known for board in self._boards for known in (board, board.finer) if known]
        return next(
            board for board in boards if board.look is last.look and board.variant == last.variant
        )

    def _search(
        self,
        grey: np.ndarray,
        quads: Array,
        boards: list[MarkedBoard],
        is_over: IsOver,
        least: int,
    ) -> list[Located]:
        """The boards that at least so many of the quadrilaterals (n, 4, 2) show."""
        if len(quads) == 0 or is_over():
            return []
        scores = {key: reader.scores(grey, quads) for key, reader in self._readers.items()}
        claims: list[tuple[MarkerGroup, MarkedBoard]] = []
        for board in boards:
            if is_over():
                break
            key = reader_key(board.look.face)
            first = self._readers[key].first(board.look.face)
            groups = group_markers(quads, scores[key], first, board.layout)
            enough = max(least, board.least_markers)
            claims += [(group, board) for group in groups if len(group.numbers) >= enough]
        return self._settled(grey, claims, quads, is_over)

    def _settled(
        self,
        grey: np.ndarray,
        claims: list[tuple[MarkerGroup, MarkedBoard]],
        quads: Array,
        is_over: IsOver,
    ) -> list[Located]:
        """The claims that hold, heaviest first, and that no other of the quadrilaterals (n, 4, 2)
        contradicts.

        A quadrilateral belongs to one board, and a look that is one face's alone is seen once.
        """
        found: list[Located] = []
        taken, seen, refused = set[int](), set[int](), 0
        for group, board in sorted(claims, key=lambda claim: -claim[0].weight):
            if is_over() or refused == MOST_REFUSED:
                break
            if id(board.look) in seen or not taken.isdisjoint(group.quads.tolist()):
                continue
            reader = self._readers[reader_key(board.look.face)]
            measured = board.locate(grey, group, reader, is_over)
            if measured is None:
                refused += 1
            elif self._is_contradicted(grey, board, measured, quads):
                self._denied.append(Located(board.look, measured, board.variant))
                taken.update(group.quads.tolist())
            else:
                board, measured = refined(grey, board, measured, is_over)
                found.append(Located(board.look, measured, board.variant))
                taken.update(group.quads.tolist())
                seen.update([id(board.look)] if board.look.is_unique else [])
        return found


def _overlap(board: Located, other: Located) -> bool:
    """Whether two boards of one look lie on each other in the picture."""
    if board.look is not other.look:
        return False
    one, two = (
        each.found.fit.project(CornerPattern.of(each.look.face).outline).astype(np.float32)
        for each in (board, other)
    )
    return cv2.intersectConvexConvex(one, two)[0] > 0
