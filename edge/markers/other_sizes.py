"""Boards that differ in more than people mean to: in columns and rows, first marker, size of
markers, pattern, and all that at once.

The markers in view vote: of all boards that have them, the one on whose plane most of them lie.
"""

from collections.abc import Iterator, Sequence

import cv2
import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.base.errors import TargetError
from trigpoint.edge.image.median import median
from trigpoint.edge.image.time_limit import IsOver, never
from trigpoint.edge.registration.appearance import Appearance
from trigpoint.edge.registration.dictionaries import dictionary_of
from trigpoint.edge.registration.printed_pattern import charuco_layout
from trigpoint.geometry.rotation import Array
from trigpoint.site.target import Face, Numbering, Pattern

from .markers import Markers
from .other_boards import UNMIRROR, Reading, kind_of, markers_of, toml

# Boards have hardly more columns or rows.
_MOST = 24
# A homography takes four; more must agree with them.
LEAST_VOTES = 6
# How far a marker's middle may lie from where the others put it, of the marker's side; and what is
# measured wrong of its size where corners are blurred.
_NEAR, _MARKER_SHARE = 0.2, 0.1
# Where six of ten markers are on the board, so many draws of four miss it once in 250 times.
_MOST_TRIES = 40
# So many markers vote, the surest: a wall has hundreds. On all boards together a marker's vote
# takes as long as so many readings of a quadrilateral.
MOST_VOTERS, READINGS_A_VOTER = 40, 200


class OtherSize(Struct, frozen=True):
    """A board that may be meant by a look, as far as it is seen: it may go on below. `numbers`:
    (k,) its markers that agree, of which `which` (k,) of those that were read; `otherwise`: boards
    with other first markers on which as many agree."""

    reading: Reading
    face: Face
    numbers: np.ndarray
    which: np.ndarray
    otherwise: tuple["OtherSize", ...] = ()

    @property
    def look(self) -> Appearance:
        return self.reading.look

    def is_as(self, told: Face) -> bool:
        """Whether a face is described so, as far as it is seen."""
        return self._is_as_large(told) and not self._changes(told) and not self.reading.is_mirrored

    def _is_as_large(self, told: Face) -> bool:
        face = self.face
        is_alike = (face.pattern, face.columns) == (told.pattern, told.columns)
        return is_alike and face.rows <= told.rows

    def _changes(self, told: Face) -> list[str]:
        face = self.face
        keys = ["pattern", "dictionary", "first_marker", "inverted", "border_bits"]
        keys.append("legacy" if face.pattern is Pattern.CHARUCO else "numbering")
        if kind_of(face.dictionary or "") == kind_of(told.dictionary or ""):
            keys.remove("dictionary")
        values = [(key, getattr(face, key)) for key in keys]
        found = [f"{key} = {toml(v)}" for key, v in values if v != getattr(told, key)]
        return found + [f"marker = {face.marker:.2g} or so"] * (not self._has_markers_of(told))

    def _has_markers_of(self, told: Face) -> bool:
        """Whether its markers are as large beside its squares as those of a face."""
        seen, known = ((face.marker or 0.0) / face.square for face in (self.face, told))
        return abs(seen - known) <= _MARKER_SHARE * known

    @property
    def differences(self) -> int:
        """In how many things the look differs."""
        return len(self._words()) + self.reading.is_mirrored

    @property
    def markers(self) -> set[tuple[str, int]]:
        """The kind and the id of each of its markers that agree."""
        return markers_of(self.face, self.numbers.tolist())

    def _words(self) -> list[str]:
        """What differs from the look, as the target file has it."""
        size = [f"columns = {self.face.columns}", f"rows = {self.face.rows} or more"]
        told = self.look.face
        return [*([] if self._is_as_large(told) else size), *self._changes(told)]

    def _beside_others(self) -> str:
        """The same of one of several that may be meant."""
        hidden = ", its first rows hidden" if self.numbers.min() > 0 else ""
        return f"{', '.join(self._words())}{hidden}"

    @property
    def remedy(self) -> str:
        """What is seen, and what to do, in one line."""
        words = ", ".join(self._words())
        if self.otherwise:
            words = ", or one with ".join(x._beside_others() for x in (self, *self.otherwise))
        is_mirrored = self.reading.is_mirrored
        seen, steps = ("a mirrored board", f"{UNMIRROR}, and ") if is_mirrored else ("a board", "")
        return (
            f"{self.look.words}: the pictures show {seen} with {words}, so it is not "
            f"used; {steps}compare the target file with the print"
        )


def other_size(
    reading: Reading, read: Markers, told: Sequence[int] = (), is_over: IsOver = never
) -> OtherSize | None:
    """What most of the markers that were `read`, each once and by its id, the surest first, agree
    on, the file's own numbers before others; None where too few agree, or as many on boards of
    other widths, or the time is over. `told`: the first markers of the site's faces."""
    if len(read) < LEAST_VOTES:
        return None
    own = _voted(reading, reading.face, read)
    if own and len(own.which) == len(read):
        return own
    few, voted = read.first(MOST_VOTERS), list[tuple[Face, OtherSize]]()
    for face in (reading.face, *_faces(reading.face, read.numbers, told)):
        if is_over():
            return None
        if each := _voted(reading, face, few):
            voted.append((face, each))
    most = max((len(each.which) for _, each in voted), default=0)
    best = [(face, each) for face, each in voted if len(each.which) == most]
    boards = [(each.face.pattern, each.face.columns) for _, each in best]
    is_own = boards[:1] == [(reading.face.pattern, reading.face.columns)]
    if not is_own and len(set(boards)) != 1:
        return None
    # It begins with the least marker that is read, or has rows before that nobody saw.
    alike = [one for one, board in zip(best, boards, strict=True) if board == boards[0]]
    alike.sort(key=lambda one: one[1].differences)
    found = _voted(reading, alike[0][0], read)
    others = {each.face.first_marker: each for _, each in reversed(alike)}
    others.pop(alike[0][1].face.first_marker)
    return found and replace(found, otherwise=tuple(others.values()))


def _voted(reading: Reading, face: Face, read: Markers) -> OtherSize | None:
    """A board with the markers that agree on it; None where these are too few."""
    which = np.flatnonzero(
        (read.numbers >= face.first_marker) & (read.numbers < face.first_marker + face.marker_count)
    )
    if len(which) < LEAST_VOTES:
        return None
    numbers = read.numbers[which] - face.first_marker
    fit, agree = _agreeing(layout_of(face)[numbers], read.corners[which])
    if fit is None or agree.sum() < LEAST_VOTES:
        return None
    seen = _as_seen(face, numbers[agree], read.corners[which[agree]], fit)
    return OtherSize(reading, seen, numbers[agree], which[agree])


def layout_of(face: Face) -> Array:
    """The markers' corners in the face frame by number, (m, 4, 2), metres."""
    if face.pattern is Pattern.CHARUCO:
        return charuco_layout(face)
    return face.corners[:, :2].reshape(-1, 4, 2)


def _faces(face: Face, ids: np.ndarray, told: Sequence[int]) -> Iterator[Face]:
    """Boards of every width, with the rows that the markers `ids` need.

    They begin as the face, as the one of the site (`told`) that the least id may be of, whose first
    row may be hidden, or with that id.
    """
    least = int(ids.min())
    begins = [first for first in told if first <= least]
    for first in dict.fromkeys((face.first_marker, max(begins, default=least), least)):
        for other in _ways(face):
            for columns in range(2, _MOST + 1):
                changed = replace(other, columns=columns, first_marker=first)
                if reaching := _reaching(changed, int(ids.max())):
                    yield reaching


def _ways(face: Face) -> tuple[Face, ...]:
    """Both layouts of either pattern, the file's own first."""
    is_charuco, kalibr = face.pattern is Pattern.CHARUCO, face.numbering is Numbering.KALIBR
    charuco = replace(face, pattern=Pattern.CHARUCO)
    grid = replace(face, pattern=Pattern.APRILGRID)
    charucos = charuco, replace(charuco, legacy=not face.legacy)
    numbering = Numbering.TOP_LEFT if kalibr else Numbering.KALIBR
    grids = grid, replace(grid, numbering=numbering)
    return charucos + grids if is_charuco else grids + charucos


def _reaching(face: Face, last: int) -> Face | None:
    """The face with as few rows as have the marker `last`, or as many as its dictionary has."""
    fields = (last - face.first_marker + 1) * (2 if face.pattern is Pattern.CHARUCO else 1)
    for rows in range(min(max(-(-fields // face.columns), 2), _MOST), 1, -1):
        reached = replace(face, rows=rows)
        try:
            dictionary_of(reached)
        except TargetError:
            continue
        return reached
    return None


def _agreeing(layout: Array, corners: Array) -> tuple[Array | None, np.ndarray]:
    """The homography from the board that most markers (n, 4, 2) agree on, by their middles, and
    which do, (n,)."""
    sides = np.linalg.norm(corners[:, 2] - corners[:, 0], axis=-1) / np.sqrt(2)
    near = _NEAR * median(sides)
    fit, agree = cv2.findHomography(
        layout.mean(axis=1), corners.mean(axis=1), cv2.RANSAC, near, maxIters=_MOST_TRIES
    )
    if fit is None:
        return None, np.zeros(len(layout), bool)
    fit = np.asarray(fit, float)
    return fit, agree.ravel().astype(bool) & _are_shaped_so(layout, corners, fit)


def _are_shaped_so(layout: Array, corners: Array, fit: Array) -> np.ndarray:
    """Which markers (n, 4, 2) are shaped as a fit of their middles has them, (n,), whatever their
    size, or on their heads: the middles of two rows alone fit many a sheared board."""
    expected = cv2.perspectiveTransform(layout.reshape(1, -1, 2), fit).reshape(-1, 4, 2)
    expected = expected - expected.mean(axis=1, keepdims=True)
    seen = corners - corners.mean(axis=1, keepdims=True)
    across = np.sum(expected * seen, axis=(1, 2))
    scale = across / np.maximum(np.sum(expected**2, axis=(1, 2)), 1e-9)
    off = np.linalg.norm(seen - scale[:, None, None] * expected, axis=-1).mean(axis=1)
    return off < _NEAR * np.linalg.norm(seen, axis=-1).mean(axis=1)


def _as_seen(face: Face, numbers: np.ndarray, corners: Array, fit: Array) -> Face:
    """The face with the rows that are seen, and markers as large as they are seen."""
    there = corners.reshape(1, -1, 2).astype(float)
    back = cv2.perspectiveTransform(there, np.linalg.inv(fit)).reshape(-1, 4, 2)
    side = median(np.linalg.norm(back[:, 2] - back[:, 0], axis=-1) / np.sqrt(2))
    told = face.marker or 0.0
    is_other = abs(side - told) > _MARKER_SHARE * told and side < face.square
    seen = _reaching(face, face.first_marker + int(numbers.max())) or face
    return replace(seen, marker=side if is_other else told)
