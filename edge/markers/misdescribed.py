"""Boards with markers that the target file describes as others: what they are.

Only markers decide: those that are surely read and agree on one place of a board. Of a small
dictionary some are read in anything, so they must be more than chance gives, most of what is in
view, and more than the file itself explains. Nothing is guessed: such a board stays not found.
"""

from collections.abc import Sequence
from functools import cache
from math import comb, log

import cv2
import numpy as np
from msgspec import Struct

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
# With time, every other board is looked for in each of the first pictures; live, a part of them in
# each of the first ten, which is all of them. Then two in every fifth, since most cameras see no
# board most of the time.
_AT_ONCE, _FIRST, _A_PICTURE, _EVERY = 3, 10, 2, 5
# So often a board is contradicted that is none of the others, before that is said.
_OFTEN = 3


class MisdescribedBoards:
    """What pictures show of other boards in place of `looks`. `lines`: what to write, by look;
    `refused`: those that the pictures disprove, which no later picture can mend."""

    def __init__(self, looks: Sequence[Appearance], finder: QuadFinder) -> None:
        self._finder, self._waiting = finder, list(others(looks))
        faces = [look.face for look in looks]
        self._readers = readers_for(faces + [other.face for other in self._waiting])
        self._pictures = 0
        self._named = set[Appearance]()
        self._denials: dict[Appearance, int] = {}
        self.lines: dict[Appearance, str] = {}
        self.refused: set[Appearance] = set()

    def look(self, grey: np.ndarray, denied: set[Appearance], *, has_time: bool) -> None:
        """Look for other boards in a picture in which none was found, or which contradicts those
        that are `denied`; `has_time`: nobody waits for the picture's end."""
        self._pictures += 1
        count = len(self._waiting)
        if not denied and (self._pictures > _AT_ONCE or not has_time):
            count = self._share(count)
        tried, self._waiting = self._waiting[:count], self._waiting[count:]
        scene = _Scene(grey, self._finder, self._readers)
        for other in tried:
            if other.look not in self._named and self._is_seen(other, scene):
                self.lines[other.look] = other.remedy
                self._named.add(other.look)  # by the simplest change: others may print the same
        self._waiting += [other for other in tried if other.look not in self._named]
        for look in denied:
            self._deny(look)

    def _share(self, count: int) -> int:
        """How many of so many boards are looked for in this picture."""
        if self._pictures <= _FIRST:
            return min(count, max(_A_PICTURE, -(-count // _FIRST)))
        return 0 if self._pictures % _EVERY else min(count, _A_PICTURE)

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
        read = scene.read(other.face, is_mirrored=other.is_mirrored)
        return read >= _fewest(other.face) and read > scene.read(other.look.face)


class _Shown(Struct, frozen=True):
    """A picture, its negative, or the mirror image of one, with its dark quadrilaterals (n, 4, 2);
    `scores`: theirs, by reader."""

    grey: np.ndarray
    quads: Array
    scores: dict[tuple[str, int], Array]


class _Scene:
    """One picture in every way in which boards are looked for in it."""

    def __init__(
        self, grey: np.ndarray, finder: QuadFinder, readers: dict[tuple[str, int], MarkerReader]
    ) -> None:
        self._grey, self._finder, self._readers = grey, finder, readers
        self._known: dict[tuple[bool, bool], _Shown] = {}

    def read(self, face: Face, *, is_mirrored: bool = False) -> int:
        """How many of a face's markers are surely read and agree on one place of it, where they are
        most of those in view; else 0."""
        shown, key = self._shown(face.inverted, is_mirrored), reader_key(face)
        if len(shown.quads) == 0:
            return 0
        reader = self._readers[key]
        if key not in shown.scores:
            shown.scores[key] = reader.scores(shown.grey, shown.quads)
        markers = reader.best(face, shown.scores[key], shown.quads, LEAST_MEMBER)
        return max(
            (
                _sure(reader, face, shown.grey, group, layout)
                for layout in _layouts(face)
                for group in group_markers(markers, layout)
            ),
            default=0,
        )

    def _shown(self, inverted: bool, is_mirrored: bool) -> _Shown:
        key = (inverted, is_mirrored)
        if key not in self._known:
            grey = cv2.bitwise_not(self._grey) if inverted else self._grey
            grey = cv2.flip(grey, 1) if is_mirrored else grey
            self._known[key] = _Shown(grey, self._finder.find(grey), {})
        return self._known[key]


def _sure(
    reader: MarkerReader, face: Face, grey: np.ndarray, group: MarkerGroup, layout: Array
) -> int:
    codes = reader.codes(grey, group.corners)[:, reader.rows(face)]
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
def _fewest(face: Face) -> int:
    """How many surely read markers prove a board, by the chance that random bits give them."""
    dictionary = predefined_dictionary(face.dictionary or "")
    bits = dictionary.markerSize**2
    ways = sum(comb(bits, wrong) for wrong in range(int(_WRONG_SHARE * bits) + 1))
    each = bits * log(2) - log(ways)
    return int(np.ceil((_LEAST_NATS + log(4 * face.marker_count)) / each))
