"""Boards with markers that the target file describes as others: what they are.

Only markers decide: those that are surely read and agree on one place of a board. Of a small
dictionary some are read in anything, so they must be more than chance gives, most of what is in
view, and more than the file itself explains. Nothing is guessed: such a board stays not found.

What people get wrong comes together, as where a file is of another board altogether: every reading
of the markers (dictionary, border, negative, mirror image) is tried with every way to lay them out.
"""

from collections import Counter, deque
from collections.abc import Mapping, Sequence
from functools import cache
from math import comb, log

import cv2
import numpy as np

from trigpoint.edge.image.time_limit import IsOver, never
from trigpoint.edge.registration.appearance import Appearance
from trigpoint.edge.registration.dictionaries import predefined_dictionary
from trigpoint.geometry.rotation import Array
from trigpoint.site.target import Face, Pattern

from .distances import chebyshev
from .marker_groups import LEAST_MEMBER, MarkerGroup, group_markers
from .markers import MarkerReader, Markers, reader_key, whole_reader
from .other_boards import Other, Reading, readings
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
# With time, every other board is looked for in each of the first pictures; live, a tenth of them in
# each of the first ten, fewer where the time or `_MOST_READ` ends it: the others come later. Then
# two in every fifth, since most cameras see no board most of the time.
_AT_ONCE, _FIRST, _A_PICTURE, _EVERY = 3, 10, 2, 5
# Where so many quadrilaterals came in since one of the last `_LATELY` pictures, a board may have:
# a tenth of the boards again in each of so many pictures, and another one for each `_LATELY`.
_CAME_IN, _LATELY, _MOST_EAGER = 6, 50, 30
# So many readings of quadrilaterals a picture gets, then the next one goes on: all boards together
# ask for 2000 to 4000 in most real pictures, for 15,000 in the busiest.
_MOST_READ = 10_000
# So often a board is contradicted that is none of the others, and in so large a part of its
# sightings, followed ones too, while that is said; all others must have been looked for. A board
# that is as the file has it is contradicted by accident, now and then for as long as it is seen.
_OFTEN, _OFTEN_SHARE = 3, 0.1
# Quadrilaterals whose middles are as near are one, of the side.
_SAME = 0.25
# Boards have the first of a dictionary's markers, hardly more of them.
_MOST_IDS = 250


class MisdescribedBoards:
    """What pictures show of other boards in place of `looks`."""

    def __init__(self, looks: Sequence[Appearance], faces: Sequence[Face]) -> None:
        """`faces`: all of the site, of which none is another board."""
        self._looks, self._faces = looks, faces
        self._waiting = list(readings(tuple(looks)))
        self._firsts = sorted({face.first_marker for face in faces})
        self._ids = max([_MOST_IDS, *(face.first_marker + face.marker_count for face in faces)])
        self._finders = {True: QuadFinder(parts_touching=True), False: QuadFinder()}
        self._pictures, self._untried = 0, len(self._waiting)
        self._quads: deque[int] = deque(maxlen=_LATELY)
        self._eager = _MOST_EAGER
        self._named: dict[Appearance, Other | OtherSize] = {}
        self._confirmed: Counter[Appearance] = Counter()
        self._denials: Counter[Appearance] = Counter()
        self._disproven: set[Appearance] = set()

    @property
    def refused(self) -> set[Appearance]:
        """Looks not to use: those that were contradicted and are another board, which no later
        picture mends; those of the same target, printed and described together, until they were
        seen so often as the file has them; and those that are contradicted too often, as long as
        they are."""
        targets = {look.target for look in self._disproven} - {""}
        often = {look for look in self._denials if self._is_often_denied(look)}
        beside = {look for look in self._looks if look.target in targets}
        return self._disproven | often | {look for look in beside if self._confirmed[look] < _OFTEN}

    @property
    def lines(self) -> dict[Appearance, str]:
        """What to write, by look; of several that the same markers tell of, the one that differs
        from its look in fewest keys: they are on one board."""
        said = list[Other | OtherSize]()
        for shown in sorted(self._named.values(), key=lambda shown: shown.differences):
            if not any(shown.markers & each.markers for each in said):
                said.append(shown)
        often = [look for look in self._denials if self._is_often_denied(look)]
        vague = {look: _vague(look) for look in often if look not in self._named}
        return vague | {shown.look: shown.remedy for shown in said}

    def look(
        self,
        grey: np.ndarray,
        denied: set[Appearance],
        is_over: IsOver = never,
        *,
        quads: Mapping[tuple[bool, bool], Array] | None = None,
    ) -> None:
        """Look for other boards in a picture in which none was found, or which contradicts those
        that are `denied`; what there is no time for is looked for in the next one. `quads`: its
        dark quadrilaterals (n, 4, 2), as far as they are known, or its negative's, by whether it is
        that one and whether parts that touch were parted."""
        self._pictures += 1
        count, quads = len(self._waiting), quads or {}
        seen = max(map(len, quads.values()), default=0)
        if not denied and (self._pictures > _AT_ONCE or is_over is not never):
            count = self._share(count, seen)
        self._quads.extend([seen] if quads else [])
        tried: list[Reading] = []
        scene = _Scene(grey, self._finders, quads, self._ids, is_over)
        for one in self._waiting[:count]:
            if is_over() or scene.read_so_far > _MOST_READ:
                break
            tried.append(one)
            shown = None if one.look in self._named else self._shown(one, scene)
            if shown and not (isinstance(shown, OtherSize) and one.look in self._confirmed):
                self._named[one.look] = shown
        left = [one for one in tried if one.look not in self._named]
        self._waiting = self._waiting[len(tried) :] + left
        self._untried -= len(tried)
        self._denials.update(denied)
        self._disproven |= {look for look in denied if isinstance(self._named.get(look), Other)}

    def _shown(self, reading: Reading, scene: "_Scene") -> Other | OtherSize | None:
        """The board that a picture proves, if any: the one that has most markers in their places,
        those that people mean before those of any other size."""
        known, best = scene.best(reading)
        read = scene.all_markers(reading)
        size = other_size(reading, read, self._firsts, scene.is_over)
        if size and not any(map(size.is_as, self._faces)):
            count = scene.sure(size, read)
            if count > known and count >= _fewest(size.face):
                return size
        return best

    def confirm(self, look: Appearance) -> None:
        """A board that was found or followed as the file has it is of no other size: that one was
        another's."""
        self._confirmed[look] += 1
        if isinstance(self._named.get(look), OtherSize):
            del self._named[look]

    def _share(self, count: int, quads: int) -> int:
        """How many of so many boards are looked for in this picture of so many quadrilaterals."""
        if self._pictures % _LATELY == 0:
            self._eager = min(self._eager + 1, _MOST_EAGER)
        came_in = quads - min(self._quads, default=quads) >= _CAME_IN
        is_first = self._pictures <= _FIRST
        if is_first or (came_in and self._eager):
            self._eager -= not is_first
            return min(count, max(_A_PICTURE, -(-count // _FIRST)))
        return 0 if self._pictures % _EVERY else min(count, _A_PICTURE)

    def _is_often_denied(self, look: Appearance) -> bool:
        """Whether the pictures contradict it too often, after every other board was looked for."""
        seen = self._denials[look] + self._confirmed[look]
        return self._untried <= 0 and self._denials[look] >= max(_OFTEN, _OFTEN_SHARE * seen)


def _vague(look: Appearance) -> str:
    """What to say of a board that is contradicted and none of the others."""
    return (
        f"{look.words}: its markers, or its ends, are seen in other places than the target file "
        "has, so it is not used; compare columns, rows, first_marker and numbering with the print"
    )


class _Shown:
    """A picture, its negative, or a mirror image, with its dark quadrilaterals (n, 4, 2)."""

    def __init__(self, grey: np.ndarray, quads: Array, ids: int) -> None:
        """`ids`: as of `_Scene`."""
        self.grey, self.quads, self._ids = grey, quads, ids
        self._scores: dict[tuple[str, int], Array] = {}
        self._any: dict[tuple[str, int], Markers] = {}
        self._plain: dict[tuple[str, int], Markers] = {}

    @property
    def read_so_far(self) -> int:
        """How many quadrilaterals were read, each time."""
        return len(self.quads) * len(self._scores)

    def reader(self, face: Face, border_bits: int = 0) -> MarkerReader:
        """The reader of a face's dictionary, with its border or another one."""
        return whole_reader(face.dictionary or "", border_bits or face.border_bits, self._ids)

    def groups(self, face: Face, layout: Array) -> list[MarkerGroup]:
        """What quadrilaterals show of a face whose markers lie so, where they can prove it."""
        scores, first = self._scores[reader_key(face)], self.reader(face).first(face)
        return group_markers(self.quads, scores, first, layout, fewest=_fewest(face))

    def any(self, face: Face) -> Markers:
        """The same of any of its dictionary's markers, by their ids."""
        key = reader_key(face)
        if key not in self._any:
            self._scores[key] = self.reader(face).scores(self.grey, self.quads)
            self._any[key] = MarkerReader.likeliest(self._scores[key], self.quads, LEAST_MEMBER)
        return self._any[key]

    def plain(self, face: Face) -> Markers:
        """Those of these that are plainly read, each once."""
        key = reader_key(face)
        if key not in self._plain:
            read = self.any(face)
            self._plain[key] = read.first(int(np.sum(read.scores >= _PLAINLY))).each_once()
        return self._plain[key]


class _Scene:
    """One picture in every way in which boards are looked for in it."""

    def __init__(
        self,
        grey: np.ndarray,
        finders: Mapping[bool, QuadFinder],
        quads: Mapping[tuple[bool, bool], Array],
        ids: int,
        is_over: IsOver,
    ) -> None:
        """`finders`: by whether they part what touches; `quads`: that are known, as of `look`;
        `ids`: so many markers of each dictionary are read, from its first on."""
        self._grey, self._finders, self._quads, self._ids = grey, finders, quads, ids
        self.is_over = is_over
        self._known: dict[tuple[bool, bool], _Shown] = {}
        self._votes = 0

    @property
    def read_so_far(self) -> int:
        """How many quadrilaterals were read, votes on boards as so many of them."""
        read = sum(shown.read_so_far for shown in self._known.values())
        return read + READINGS_A_VOTER * self._votes

    def read(self, face: Face, *, is_mirrored: bool = False) -> int:
        """How many of a face's markers are surely read and agree on one place of it, where they are
        most of those in view; else 0."""
        shown = self._shown(face.inverted, is_mirrored)
        return _agreeing(face, shown) if len(shown.quads) else 0

    def best(self, reading: Reading) -> tuple[int, Other | None]:
        """How many markers the best of a reading's boards has in their places, the simplest change
        where they are as many: others may print the same; and which it is, if that is proven."""
        others = reading.others
        read = [self.read(other.face, is_mirrored=other.is_mirrored) for other in others]
        if not read:
            return 0, None
        best = others[int(np.argmax(read))]
        is_proven = max(read) >= _fewest(best.face) and max(read) > self.read(reading.look.face)
        return max(read), best if is_proven else None

    def all_markers(self, reading: Reading) -> Markers:
        """The markers of a reading's dictionary that are surely read anywhere, by id, each once."""
        shown = self._shown(reading.face.inverted, reading.is_mirrored)
        read = shown.plain(reading.face)
        self._votes += min(len(read), MOST_VOTERS)
        return read

    def sure(self, size: OtherSize, read: Markers) -> int:
        """As `read`, of a board that the markers that were read suggest."""
        face, corners = size.face, read.corners[size.which]
        group = MarkerGroup(size.numbers, corners, read.quads[size.which], 0.0)
        shown = self._shown(face.inverted, size.reading.is_mirrored)
        return max(_sure(face, shown, group, layout) for layout in _layouts(face))

    def _shown(self, inverted: bool, is_mirrored: bool) -> _Shown:
        key = (inverted, is_mirrored)
        if key not in self._known:
            if is_mirrored:
                plain = self._shown(inverted, False)
                quads = plain.quads[:, ::-1] * (-1, 1) + (self._grey.shape[1] - 1, 0)
                shown = _Shown(cv2.flip(plain.grey, 1), quads, self._ids)
            else:
                grey = cv2.bitwise_not(self._grey) if inverted else self._grey
                shown = _Shown(grey, self._found(grey, inverted), self._ids)
            self._known[key] = shown
        return self._known[key]

    def _found(self, grey: np.ndarray, inverted: bool) -> Array:
        """The dark quadrilaterals (n, 4, 2) that any of the finders sees, each once, as the first
        has it. A board may have squares that touch its tags: who looks for such goes first, since
        the other one sees whole clumps of them; it loses small markers beside other squares, which
        the other one adds."""
        quads, more = (
            self._quads[inverted, parts] if (inverted, parts) in self._quads else finder.find(grey)
            for parts, finder in self._finders.items()
        )
        sides = np.linalg.norm(more[:, 1] - more[:, 0], axis=-1)
        apart = chebyshev(more.mean(axis=1), quads.mean(axis=1))
        return np.concatenate([quads, more[np.all(apart > _SAME * sides[:, None], axis=1)]])


def _agreeing(face: Face, shown: _Shown) -> int:
    """How many of a face's markers are surely read and agree on one place of it."""
    if len(shown.any(face)) < _fewest(face):
        return 0
    return max(
        (
            _sure(face, shown, group, layout)
            for layout in _layouts(face)
            for group in shown.groups(face, layout)
        ),
        default=0,
    )


def _sure(face: Face, shown: _Shown, group: MarkerGroup, layout: Array) -> int:
    reader, grey = shown.reader(face), shown.grey
    is_read = reader.code_agreement(grey, face, group.corners, group.numbers) > _READ
    # A border of one cell reads as one of two where cells are few, only worse.
    other = shown.reader(face, 2 if face.border_bits == 1 else 1)
    as_said, otherwise = (
        each.agreement(grey, face, group.corners, group.numbers) for each in (reader, other)
    )
    count = int(np.sum(is_read & (as_said >= otherwise)))
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
