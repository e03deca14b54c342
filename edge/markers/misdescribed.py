"""Boards with markers that the target file describes as others: what they are.

Only markers decide: those that are surely read and agree on one place of a board. Of a small
dictionary some are read in anything, so they must be more than chance gives, most of what is in
view, and more than the file itself explains. Nothing is guessed: such a board stays not found.

What people get wrong comes together, as where a file is of another board altogether: every reading
of the markers (dictionary, border, negative, mirror image) is tried with every way to lay them out.
"""

from collections.abc import Sequence
from functools import cache
from math import comb, log
from typing import Protocol

import cv2
import numpy as np
from msgspec import Struct

from trigpoint.edge.image.time_limit import IsOver, never
from trigpoint.edge.registration.appearance import Appearance
from trigpoint.edge.registration.dictionaries import predefined_dictionary
from trigpoint.geometry.rotation import Array
from trigpoint.site.target import Face, Pattern

from .marker_groups import LEAST_MEMBER, MarkerGroup, group_markers
from .markers import MarkerReader, Markers, reader_key, readers_for, whole_reader
from .other_boards import Other, Others, others
from .other_sizes import MOST_VOTERS, READINGS_A_VOTER, OtherSize, layout_of, other_size
from .quads import QuadFinder

# How well a code must be read: an eighth of its bits may be wrong.
_READ, _WRONG_SHARE = 0.75, 1 / 8
# The same of all of its cells, with the border that all markers have.
_PLAINLY = 0.9
# Of a thousand sites none may be told of a board that is not there; each has ten pictures of
# hundreds of quadrilaterals, tried as two hundred boards.
_LEAST_NATS = log(1_000 * 10 * 300 * 200)
# Of a board's markers in view, how many must be read: more are on the board that it is, where some
# are hidden, than on one that shares a row with it.
_LEAST_SHARE = 0.6
# With time, every other board is looked for in each of the first pictures; live, a part of them in
# each of the first ten, which is all of them. Then two in every fifth, since most cameras see no
# board most of the time.
_AT_ONCE, _FIRST, _A_PICTURE, _EVERY = 3, 10, 2, 5
# So many readings of quadrilaterals a picture gets, then the next one goes on: all boards together
# ask for 8000 in the median photograph, 18,000 at most, and for 80,000 before a wall of tags.
_MOST_READ = 20_000
# So often a board is contradicted that is none of the others, before that is said.
_OFTEN = 3


class MisdescribedBoards:
    """What pictures show of other boards in place of `looks`. `lines`: what to write, by look;
    `refused`: those that the pictures disprove, which no later picture can mend."""

    def __init__(self, looks: Sequence[Appearance], *, parts_touching: bool = False) -> None:
        """`parts_touching`: as of `QuadFinder`; another board than the file's may need it."""
        alike = list(others(looks))
        own = {one[0].look: one for one in alike if one[0].reads_as_described}
        self._waiting: list[_Tried] = [_Own(look, own.get(look, ())) for look in looks]
        self._waiting += [_Foreign(one) for one in alike if not one[0].reads_as_described]
        faces = [look.face for look in looks]
        faces += [other.face for one in alike for other in one]
        self._finder = QuadFinder(parts_touching=parts_touching)
        self._readers = readers_for(faces)
        self._pictures = 0
        self._named: dict[Appearance, Other | OtherSize] = {}
        self._confirmed = set[Appearance]()
        self._denials: dict[Appearance, int] = {}
        self.lines: dict[Appearance, str] = {}
        self.refused: set[Appearance] = set()

    def look(self, grey: np.ndarray, denied: set[Appearance], is_over: IsOver = never) -> None:
        """Look for other boards in a picture in which none was found, or which contradicts those
        that are `denied`; what there is no time for is looked for in the next one."""
        self._pictures += 1
        count = len(self._waiting)
        if not denied and (self._pictures > _AT_ONCE or is_over is not never):
            count = self._share(count)
        tried: list[_Tried] = []
        scene = _Scene(grey, self._finder, self._readers, is_over)
        for one in self._waiting[:count]:
            if is_over() or scene.read_so_far > _MOST_READ:
                break
            tried.append(one)
            shown = None if one.look in self._named else one.shown(scene)
            if shown and not (isinstance(shown, OtherSize) and one.look in self._confirmed):
                self.lines[one.look] = shown.remedy
                self._named[one.look] = shown
        left = [one for one in tried if one.look not in self._named]
        self._waiting = self._waiting[len(tried) :] + left
        for look in denied:
            self._deny(look)

    def confirm(self, look: Appearance) -> None:
        """A board that was found as the file has it is of no other size: that one was another's."""
        self._confirmed.add(look)
        if isinstance(self._named.get(look), OtherSize):
            del self._named[look], self.lines[look]

    def _share(self, count: int) -> int:
        """How many of so many boards are looked for in this picture."""
        if self._pictures <= _FIRST:
            return min(count, max(_A_PICTURE, -(-count // _FIRST)))
        return 0 if self._pictures % _EVERY else min(count, _A_PICTURE)

    def _deny(self, look: Appearance) -> None:
        self._denials[look] = self._denials.get(look, 0) + 1
        if isinstance(self._named.get(look), Other):
            self.refused.add(look)
        elif look not in self._named and self._denials[look] == _OFTEN:
            self.lines[look] = (
                f"{look.words}: its markers are seen in other places than the target file has, so "
                "it is not used; compare columns, rows, first_marker and numbering with the print"
            )


class _Tried(Protocol):
    """What is looked for at once in place of a look."""

    @property
    def look(self) -> Appearance: ...

    def shown(self, scene: "_Scene") -> Other | OtherSize | None:
        """The board that a picture proves, if any."""
        ...


class _Own(Struct, frozen=True):
    """Boards of the same markers as the file's, in other places: those that people mean before
    those of any other size."""

    look: Appearance
    others: Others

    def shown(self, scene: "_Scene") -> Other | OtherSize | None:
        """The board that has most markers in their places."""
        known, best = scene.best(self.look, self.others)
        read = scene.own_markers(self.look.face)
        size = other_size(self.look, read, scene.is_over)
        if size and not size.is_as_described:
            count = scene.sure(size, read)
            if count > known and count >= _fewest(size.face):
                return size
        return best


class _Foreign(Struct, frozen=True):
    """Boards of other markers, or seen in another way, that one reading tells apart."""

    others: Others

    @property
    def look(self) -> Appearance:
        return self.others[0].look

    def shown(self, scene: "_Scene") -> Other | None:
        """The board that has most markers in their places."""
        return scene.best(self.look, self.others)[1]


class _Shown(Struct, frozen=True):
    """A picture, its negative, or the mirror image of one, with its dark quadrilaterals (n, 4, 2);
    `scores`: theirs, by reader."""

    grey: np.ndarray
    quads: Array
    scores: dict[tuple[str, int], Array]


class _Scene:
    """One picture in every way in which boards are looked for in it; `read_so_far`: how many
    quadrilaterals were, each time."""

    def __init__(
        self,
        grey: np.ndarray,
        finder: QuadFinder,
        readers: dict[tuple[str, int], MarkerReader],
        is_over: IsOver,
    ) -> None:
        self._grey, self._finder, self._readers = grey, finder, readers
        self.is_over = is_over
        self._known: dict[tuple[bool, bool], _Shown] = {}
        self.read_so_far = 0

    def read(self, face: Face, *, is_mirrored: bool = False) -> int:
        """How many of a face's markers are surely read and agree on one place of it, where they are
        most of those in view; else 0."""
        shown, key = self._shown(face.inverted, is_mirrored), reader_key(face)
        self.read_so_far += len(shown.quads)
        if len(shown.quads) == 0:
            return 0
        if key not in shown.scores:
            shown.scores[key] = self._readers[key].scores(shown.grey, shown.quads)
        return _agreeing(self._readers[key], face, shown, shown.scores[key])

    def best(self, look: Appearance, others: Others) -> tuple[int, Other | None]:
        """How many markers the best of the boards has in their places, the simplest change where
        they are as many: others may print the same; and which it is, if that is proven."""
        read = [self.read(other.face, is_mirrored=other.is_mirrored) for other in others]
        if not read:
            return 0, None
        best = others[int(np.argmax(read))]
        is_proven = max(read) >= _fewest(best.face) and max(read) > self.read(look.face)
        return max(read), best if is_proven else None

    def own_markers(self, face: Face) -> Markers:
        """The markers of a face's dictionary that are surely read anywhere, by id, each once."""
        shown = self._shown(face.inverted, False)
        reader = whole_reader(*reader_key(face))
        scores = reader.scores(shown.grey, shown.quads)
        read = reader.likeliest(scores, shown.quads, _PLAINLY).each_once()
        self.read_so_far += READINGS_A_VOTER * min(len(read), MOST_VOTERS)
        return read

    def sure(self, size: OtherSize, read: Markers) -> int:
        """As `read`, of a board that the markers that were read suggest."""
        face, corners = size.face, read.corners[size.which]
        group = MarkerGroup(size.numbers, corners, read.quads[size.which], 0.0)
        grey, reader = self._shown(face.inverted, False).grey, whole_reader(*reader_key(face))
        return max(_sure(reader, face, grey, group, layout) for layout in _layouts(face))

    def _shown(self, inverted: bool, is_mirrored: bool) -> _Shown:
        key = (inverted, is_mirrored)
        if key not in self._known:
            grey = cv2.bitwise_not(self._grey) if inverted else self._grey
            grey = cv2.flip(grey, 1) if is_mirrored else grey
            self._known[key] = _Shown(grey, self._finder.find(grey), {})
        return self._known[key]


def _agreeing(reader: MarkerReader, face: Face, shown: _Shown, scores: Array) -> int:
    """How many of a face's markers are surely read and agree on one place of it."""
    markers = reader.best(face, scores, shown.quads, LEAST_MEMBER)
    if len(markers) < _fewest(face):
        return 0
    return max(
        (
            _sure(reader, face, shown.grey, group, layout)
            for layout in _layouts(face)
            for group in group_markers(markers, layout)
        ),
        default=0,
    )


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
    upright = layout_of(face)
    if face.pattern is Pattern.CHARUCO:
        return [upright]
    return [upright, np.roll(upright, 2, axis=1)]


@cache
def _fewest(face: Face) -> int:
    """How many surely read markers prove a board, by the chance that random bits give them."""
    dictionary = predefined_dictionary(face.dictionary or "")
    bits = dictionary.markerSize**2
    ways = sum(comb(bits, wrong) for wrong in range(int(_WRONG_SHARE * bits) + 1))
    each = bits * log(2) - log(ways)
    return int(np.ceil((_LEAST_NATS + log(4 * face.marker_count)) / each))
