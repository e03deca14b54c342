"""Finds faces in one camera's pictures, one after the other, by where they were before.

A face that was seen is first looked for where its motion puts it, then around there; the whole
picture is searched where nothing is followed, and now and then for faces that come in.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trigpoint.clock import Clock, SystemClock
from trigpoint.geometry.rotation import Array
from trigpoint.messages import FaceSighting
from trigpoint.target import Target

from .detector import FaceFinder, IsOver, finders_for
from .measurement import LEAST_CORNERS, Located, Measured
from .picture import as_grey
from .planar_fit import PlanarFit, fit_plane

# While faces are followed, the whole picture is searched so often.
SEARCH_EVERY_NS = 500_000_000
# A face that was not seen for so long is not looked for any more.
FORGET_NS = 400_000_000
# How far around a face's box it is looked for, of the box, and at least, pixels.
AROUND_SHARE = 0.25
LEAST_AROUND_PX = 24
# Of a face's corners' spacing: a followed face that moves further from its prediction may be
# another part of the pattern.
MOST_OFF_SHARE = 0.4


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """A face that is followed: what was last seen of it and when, and its motion across the
    undistorted picture, pixels a second; None until it was seen twice."""

    located: Located
    seen_ns: int
    velocity: Array | None


class TargetTracker:
    """Like a TargetDetector, for the pictures of one camera in order; one instance a thread.

    `given_up`: how many pictures took longer than the budget and were answered with what was found
    until then.
    """

    def __init__(
        self,
        targets: Sequence[Target],
        *,
        budget_s: float | None = None,
        clock: Clock | None = None,
    ) -> None:
        """`budget_s`: a search that takes longer is given up. Raises TargetError."""
        self._finders = finders_for(targets)
        self._budget_ns = None if budget_s is None else round(budget_s * 1e9)
        self._clock = clock or SystemClock()
        self._tracks: list[Track] = []
        self._searched_ns: int | None = None
        self._shape: tuple[int, ...] = ()
        self.given_up = 0

    def detect(self, picture: np.ndarray, stamp_ns: int) -> tuple[FaceSighting, ...]:
        """The faces in a picture, taken at `stamp_ns`; raises InputError as a detector does."""
        grey = as_grey(picture)
        budget = _Budget(self._clock, self._budget_ns)
        self._forget(grey.shape, stamp_ns)
        found = self._followed(grey, stamp_ns, budget.is_over)
        if self._is_search_due(stamp_ns, all_found=len(found) == len(self._tracks)):
            self._searched_ns = stamp_ns
            found = self._searched(grey, found, budget.is_over)
        self._tracks = self._renewed(found, stamp_ns)
        self.given_up += budget.was_over
        return tuple(located.sighting for located in found)

    def _forget(self, shape: tuple[int, ...], stamp_ns: int) -> None:
        """Drop what says nothing of this picture; all where the pictures go back or change."""
        if shape != self._shape or any(track.seen_ns >= stamp_ns for track in self._tracks):
            self._tracks, self._searched_ns = [], None
        self._shape = shape
        self._tracks = [t for t in self._tracks if stamp_ns - t.seen_ns <= FORGET_NS]

    def _is_search_due(self, stamp_ns: int, *, all_found: bool) -> bool:
        if not self._tracks or self._searched_ns is None or not all_found:
            return True
        return stamp_ns - self._searched_ns >= SEARCH_EVERY_NS

    def _followed(self, grey: np.ndarray, stamp_ns: int, is_over: IsOver) -> list[Located]:
        """The faces that are where they can be by now."""
        found: list[Located] = []
        missing: list[Track] = []
        for track in self._tracks:
            located = None if is_over() else self._where_expected(grey, track, stamp_ns)
            if located is not None and not _is_among(located, found):
                found.append(located)
            else:
                missing.append(track)
        for box in _boxes(missing, stamp_ns, grey.shape):
            if is_over():
                break
            for located in self._in_part(grey, box, is_over):
                if not _is_among(located, found):
                    found.append(located)
        return found

    def _where_expected(self, grey: np.ndarray, track: Track, stamp_ns: int) -> Located | None:
        if track.velocity is None:
            return None
        last = track.located
        fit = last.found.fit.moved(track.velocity * (stamp_ns - track.seen_ns) * 1e-9)
        located = self._finder(last).follow(grey, last, fit)
        if located is None:
            return None
        return located if _is_near(located, fit) else None

    def _in_part(self, grey: np.ndarray, box: "_Box", is_over: IsOver) -> list[Located]:
        """What any finder locates in a part of the picture, in the whole one's pixels."""
        part = np.ascontiguousarray(grey[box.top : box.bottom, box.left : box.right])
        size = (grey.shape[1], grey.shape[0])
        found = []
        for finder in self._finders.values():
            for located in finder.locate(part, is_over):
                whole = _in_whole(located, np.array([box.left, box.top], dtype=float), size)
                found += [whole] if whole else []
        return found

    def _searched(self, grey: np.ndarray, found: list[Located], is_over: IsOver) -> list[Located]:
        """What is found and what a search of the whole picture adds."""
        found = list(found)
        for finder in self._finders.values():
            if is_over():
                break
            new = finder.locate(grey, is_over)
            found += [located for located in new if not _is_among(located, found)]
        return found

    def _renewed(self, found: list[Located], stamp_ns: int) -> list[Track]:
        """Tracks of what was found, and of what was missed just now."""
        tracks = []
        left = list(self._tracks)
        for located in found:
            last = next((t for t in left if _is_same(t, located, stamp_ns)), None)
            if last is not None:
                left.remove(last)
            tracks.append(Track(located, stamp_ns, _velocity(last, located, stamp_ns)))
        return tracks + left

    def _finder(self, located: Located) -> FaceFinder:
        return self._finders[located.look.face.pattern]


class _Budget:
    """The time that one picture may take."""

    def __init__(self, clock: Clock, budget_ns: int | None) -> None:
        self._clock = clock
        self._end_ns = None if budget_ns is None else clock.elapsed_ns() + budget_ns
        self.was_over = False

    def is_over(self) -> bool:
        """Whether it is used up; asked between the steps of a search."""
        self.was_over = self._end_ns is not None and self._clock.elapsed_ns() > self._end_ns
        return self.was_over


@dataclass(frozen=True, slots=True)
class _Box:
    """A part of a picture, in whole pixels."""

    left: int
    top: int
    right: int
    bottom: int

    def joined(self, other: "_Box") -> "_Box":
        """The least box around both."""
        return _Box(
            min(self.left, other.left),
            min(self.top, other.top),
            max(self.right, other.right),
            max(self.bottom, other.bottom),
        )

    def meets(self, other: "_Box") -> bool:
        """Whether they have anything in common."""
        across = self.left < other.right and other.left < self.right
        return across and self.top < other.bottom and other.top < self.bottom


def _boxes(tracks: Sequence[Track], stamp_ns: int, shape: tuple[int, ...]) -> list[_Box]:
    """Where the faces of tracks can be; boxes that meet are one."""
    boxes: list[_Box] = []
    for track in tracks:
        box = _box(track, stamp_ns, shape)
        if box is None:
            continue
        for other in [other for other in boxes if other.meets(box)]:
            boxes.remove(other)
            box = box.joined(other)
        boxes.append(box)
    return boxes


def _box(track: Track, stamp_ns: int, shape: tuple[int, ...]) -> _Box | None:
    """Where the face of a track can be: around its outline, there and where it moves to."""
    last = track.located
    moved = np.zeros(2)
    if track.velocity is not None:
        moved = track.velocity * (stamp_ns - track.seen_ns) * 1e-9
    outline = last.found.fit.project(last.look.face.outline[:, :2])
    around = np.concatenate([outline, last.found.pixels])
    low = np.minimum(around.min(axis=0), around.min(axis=0) + moved)
    high = np.maximum(around.max(axis=0), around.max(axis=0) + moved)
    margin = np.maximum(AROUND_SHARE * (high - low), LEAST_AROUND_PX)
    size = np.array([shape[1], shape[0]])
    left, top = np.clip(np.floor(low - margin), 0, size).astype(int).tolist()
    right, bottom = np.clip(np.ceil(high + margin), 0, size).astype(int).tolist()
    return _Box(left, top, right, bottom) if right - left > 16 and bottom - top > 16 else None


def _in_whole(located: Located, offset: Array, size: tuple[int, int]) -> Located | None:
    """What was located in a part of a picture that begins at `offset` (2,)."""
    found = located.found
    pixels = found.pixels + offset
    points = located.look.face.corners[found.corners, :2]
    fit = fit_plane(points, pixels, size)
    if fit is None:
        return None
    whole = Measured(found.corners, pixels, found.sigma, found.blur, fit)
    return Located(located.look, whole)


def _is_near(located: Located, fit: PlanarFit) -> bool:
    """Whether a face is where it was expected, by less than half a square."""
    face = located.look.face
    points = face.corners[located.found.corners, :2]
    expected = fit.project(points)
    across = fit.project(points + np.array([face.square, 0.0])) - expected
    down = fit.project(points + np.array([0.0, face.square])) - expected
    spacing = np.minimum(np.linalg.norm(across, axis=-1), np.linalg.norm(down, axis=-1))
    off = np.linalg.norm(located.found.pixels - expected, axis=-1)
    return bool(np.median(off / np.maximum(spacing, 1e-9)) < MOST_OFF_SHARE)


def _is_among(located: Located, found: Sequence[Located]) -> bool:
    """Whether a face is one of those: the only one of its look, or in the same place."""
    middle = located.found.pixels.mean(axis=0)
    for other in found:
        if other.look is not located.look:
            continue
        near = np.abs(other.found.pixels.mean(axis=0) - middle)
        if located.look.is_unique or np.all(near < 0.25 * np.ptp(other.found.pixels, axis=0)):
            return True
    return False


def _is_same(track: Track, located: Located, stamp_ns: int) -> bool:
    """Whether what was located is the face of a track."""
    if track.located.look is not located.look:
        return False
    if located.look.is_unique:
        return True
    moved = _shift(track.located, located)
    expected = np.zeros(2)
    if track.velocity is not None:
        expected = track.velocity * (stamp_ns - track.seen_ns) * 1e-9
    reach = 0.5 * np.ptp(track.located.found.pixels, axis=0) + LEAST_AROUND_PX
    return bool(np.all(np.abs(moved - expected) < reach))


def _velocity(last: Track | None, located: Located, stamp_ns: int) -> Array | None:
    if last is None or len(located.found.corners) < LEAST_CORNERS:
        return None
    return _shift(last.located, located) / ((stamp_ns - last.seen_ns) * 1e-9)


def _shift(before: Located, after: Located) -> Array:
    """How far the middle of a face moved in the undistorted picture, pixels."""
    middle = before.look.face.corners[:, :2].mean(axis=0)[None]
    places = [located.found.fit.straight(middle)[0] for located in (before, after)]
    return places[1] - places[0]
