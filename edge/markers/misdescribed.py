"""Boards with markers that the target file describes as others: what they are, and what to write.

Only markers decide: those that are surely read and agree on one place of a board. Of a small
dictionary some are read in anything, so they must be more than chance gives, most of what is in
view, and more than the file itself explains. Nothing is guessed: such a board stays not found.
"""

from collections.abc import Sequence
from functools import cache
from math import comb, log

import cv2
import numpy as np

from trigpoint.edge.registration.appearance import Appearance
from trigpoint.edge.registration.dictionaries import predefined_dictionary
from trigpoint.edge.registration.printed_pattern import charuco_layout
from trigpoint.geometry.rotation import Array
from trigpoint.site.target import Face, Pattern

from .marker_groups import LEAST_MEMBER, MarkerGroup, group_markers
from .markers import MarkerReader, reader_key, readers_for
from .other_boards import Other, others
from .quads import QuadFinder

# How well a code must be read: an eighth of its bits may be wrong.
_READ, _WRONG_SHARE = 0.75, 1 / 8
# Of a thousand sites none may be told of a board that is not there; each has ten pictures of
# hundreds of quadrilaterals, tried as a dozen boards.
_LEAST_NATS = log(1_000 * 10 * 300 * 12)
# Of a board's markers in view, how many must be read: more are on the board that it is, where some
# are hidden, than on one that shares a row with it.
_LEAST_SHARE = 0.6
# In the first pictures every other board is looked for, in the next ones two in each, which is all
# of them, and then two in every fifth, since most cameras see no board most of the time.
_AT_ONCE, _NEXT, _A_PICTURE, _EVERY = 3, 10, 2, 5
# So often a board is contradicted that is none of the others, before that is said.
_OFTEN = 3


class MisdescribedBoards:
    """What pictures show of other boards in place of `looks`. `lines`: what to write, by look;
    `refused`: those that the pictures disprove, which no later picture can mend."""

    def __init__(self, looks: Sequence[Appearance], finder: QuadFinder) -> None:
        self._looks, self._finder = looks, finder
        self._waiting: list[Other] | None = None
        self._pictures = 0
        self._named = set[Appearance]()
        self._denials: dict[Appearance, int] = {}
        self.lines: dict[Appearance, str] = {}
        self.refused: set[Appearance] = set()

    def look(self, grey: np.ndarray, denied: set[Appearance]) -> None:
        """Look for other boards in a picture in which none was found, or which contradicts those
        that are `denied`."""
        if self._waiting is None:
            self._waiting = list(others(self._looks))
        self._pictures += 1
        if not denied and self._pictures > _NEXT and self._pictures % _EVERY:
            return
        count = len(self._waiting)
        if not denied and self._pictures > _AT_ONCE:
            count = min(count, _A_PICTURE)
        tried, self._waiting = self._waiting[:count], self._waiting[count:]
        scene = _Scene(grey, self._finder)
        for other in tried:
            if other.look not in self._named and self._is_seen(other, scene):
                self.lines[other.look] = other.remedy
                self._named.add(other.look)  # by the simplest change: others may print the same
        self._waiting += [other for other in tried if other.look not in self._named]
        for look in denied:
            self._deny(look)

    def _deny(self, look: Appearance) -> None:
        self._denials[look] = self._denials.get(look, 0) + 1
        if look in self._named:
            self.refused.add(look)
        elif self._denials[look] == _OFTEN:
            self.lines[look] = (
                f"{look.words}: its markers are seen in other places than the target file has, so "
                "it is not used; compare columns, rows, first_marker and numbering with the print"
            )

    def _is_seen(self, other: Other, scene: "_Scene") -> bool:
        """Whether markers prove the other board, and more of them than the one described."""
        read = _read(other.face, *scene.shown(other.face, is_mirrored=other.is_mirrored))
        if read < _fewest(other.face):
            return False
        described = other.look.face
        return read > _read(described, *scene.shown(described))


class _Scene:
    """A picture, its negative, and their mirror images, with their dark quadrilaterals."""

    def __init__(self, grey: np.ndarray, finder: QuadFinder) -> None:
        self._grey, self._finder = grey, finder
        self._known: dict[tuple[bool, bool], tuple[np.ndarray, Array]] = {}

    def shown(self, face: Face, *, is_mirrored: bool = False) -> tuple[np.ndarray, Array]:
        """The picture as a face is looked for in it, and its quadrilaterals (n, 4, 2)."""
        key = (face.inverted, is_mirrored)
        if key not in self._known:
            grey = cv2.bitwise_not(self._grey) if face.inverted else self._grey
            grey = cv2.flip(grey, 1) if is_mirrored else grey
            self._known[key] = grey, self._finder.find(grey)
        return self._known[key]


def _read(face: Face, grey: np.ndarray, quads: Array) -> int:
    """How many of a face's markers are surely read and agree on one place of it, where they are
    most of those in view; else 0."""
    if len(quads) == 0:
        return 0
    reader = _reader(face)
    markers = reader.best(face, reader.scores(grey, quads), quads, LEAST_MEMBER)
    return max(
        (
            _sure(face, grey, group, layout)
            for layout in _layouts(face)
            for group in group_markers(markers, layout)
        ),
        default=0,
    )


def _sure(face: Face, grey: np.ndarray, group: MarkerGroup, layout: Array) -> int:
    codes = _reader(face).codes(grey, group.corners)
    count = int(np.sum(codes[np.arange(len(codes)), group.numbers] > _READ))
    fit, _ = cv2.findHomography(
        layout[group.numbers].reshape(-1, 2), group.corners.reshape(-1, 2), 0
    )
    if fit is None:
        return 0
    placed = cv2.perspectiveTransform(layout.reshape(1, -1, 2), fit).reshape(-1, 4, 2)
    inside = np.all((placed > 0) & (placed < np.array(grey.shape[::-1]) - 1), axis=(1, 2))
    return count if count >= _LEAST_SHARE * inside.sum() else 0


def _layouts(face: Face) -> list[Array]:
    """Where a face's markers may be, (m, 4, 2) each: tags also on their heads."""
    if face.pattern is Pattern.CHARUCO:
        return [charuco_layout(face)]
    upright = face.corners[:, :2].reshape(-1, 4, 2)
    return [upright, np.roll(upright, 2, axis=1)]


@cache
def _reader(face: Face) -> MarkerReader:
    return readers_for([face])[reader_key(face)]


def _fewest(face: Face) -> int:
    """How many surely read markers prove a board, by the chance that random bits give them."""
    dictionary = predefined_dictionary(face.dictionary or "")
    bits = dictionary.markerSize**2
    ways = sum(comb(bits, wrong) for wrong in range(int(_WRONG_SHARE * bits) + 1))
    each = bits * log(2) - log(ways)
    return int(np.ceil((_LEAST_NATS + log(4 * face.marker_count)) / each))
