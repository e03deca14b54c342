"""Follows faces through one camera's pictures.

A known face is first looked for where its motion predicts it, then around that place. The whole
picture is searched if nothing is followed, and occasionally for new faces; the surroundings of
followed faces are searched more often. What nothing was found in, and nothing changes in, is
searched occasionally too: most cameras see an empty room most of the time.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.base.clock import Clock, SystemClock
from trigpoint.contract.messages import FaceSighting
from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In, Kernel, Out
from trigpoint.site.target import Target

from .detector import finders_for, misdescribed
from .image.median import median
from .image.picture import as_grey
from .image.region import Region, regions_around
from .image.stillness import Stillness
from .image.time_limit import IsOver
from .registration.corner_pattern import CornerPattern
from .registration.finder import FaceFinder
from .registration.measurement import LEAST_CORNERS, Located
from .registration.planar_fit import FIT, PlanarFit

# How often the whole picture is searched while faces are followed, or nothing changes.
SEARCH_EVERY_NS = 500_000_000
# How often the surroundings of followed faces are searched for the robot's next face turning into
# view, if a face has moved by this share of its size since the last look.
SEARCH_BESIDE_EVERY_NS = 250_000_000
MOVED_SHARE = 0.1
# A face not seen for this long, or in this many pictures, is dropped.
FORGET_NS = 400_000_000
MOST_MISSES = 2
# Search radius around a prediction: pixels, plus a share of the motion since the last picture.
LEAST_REACH_PX = 24.0
REACH_SHARE = 0.5
MOST_REACH_PX = 80.0
# The same while its motion is unknown.
UNKNOWN_REACH_PX = 60.0
# A face this close to its prediction is first looked for exactly there next time, pixels.
NEAR_PX = 0.8
# After this share of a picture's time no further step is begun: the last one takes time too.
LAST_BEGIN = 0.7
# An outline that reaches further is a degenerate projection, pixels.
_FAR_PX = 10_000
_COARSE = 8
_FIT = In(np.float64, (FIT,))
_MOVED = Kernel(
    "tp_moved",
    _FIT,
    _FIT,
    _FIT,
    In(np.float64, ("k", 2)),
    In(np.int64, ("n",)),
    In(np.float64, ("n", 2)),
    Out(np.float64, (10,)),
)


class Track(Struct, frozen=True, eq=False):
    """A followed face: the last detection, its time, and the change per second of its homography,
    (9,); None until seen twice. `misses`: later pictures in which it was looked for in vain;
    `is_steady`: false if it was found away from its predicted place."""

    located: Located
    seen_ns: int
    change: Array | None
    misses: int = 0
    is_steady: bool = True

    def reach_px(self, expected: PlanarFit) -> float:
        """Search radius around its predicted place."""
        if self.change is None:
            return UNKNOWN_REACH_PX
        moved = expected.project(self.seen_points) - self.located.found.pixels
        way = REACH_SHARE * float(np.linalg.norm(moved.mean(axis=0)))
        return min(LEAST_REACH_PX + way, MOST_REACH_PX)

    @property
    def points(self) -> Array:
        """The corners in the face frame, (n, 2)."""
        return CornerPattern.of(self.located.look.face).points

    @property
    def seen_points(self) -> Array:
        """Those that were seen."""
        return self.points[self.located.found.corners]

    def fit_at(self, stamp_ns: int) -> PlanarFit:
        """The plane predicted for that time.

        If a plane moves without turning, two columns of its homography stay constant and the third
        changes evenly, whatever its distance; if it turns a little, this is nearly so.
        """
        fit = self.located.found.fit
        if self.change is None:
            return fit
        return fit.moved((stamp_ns - self.seen_ns) * 1e-9 * self.change)

    def renewed(self, located: Located, stamp_ns: int) -> "Track":
        """The track of this face, located again."""
        now = located.found
        change = np.empty(10)
        has_moved = len(now.corners) >= LEAST_CORNERS and _MOVED(
            now.fit.packed,
            self.located.found.fit.packed,
            self.fit_at(stamp_ns).packed,
            self.points,
            now.corners,
            now.pixels,
            change,
        )
        if not has_moved:
            return Track(located, stamp_ns, None)
        a_second = change[:9] / ((stamp_ns - self.seen_ns) * 1e-9)
        is_steady = self.change is None or bool(change[9] < NEAR_PX)
        return Track(located, stamp_ns, a_second, is_steady=is_steady)


class TargetTracker:
    """Like a TargetDetector, for one camera's pictures in order; one instance per thread.

    `given_up`: how many pictures exceeded the budget and were answered with the faces found by
    then.
    """

    def __init__(
        self,
        targets: Sequence[Target],
        *,
        budget_s: float | None = None,
        clock: Clock | None = None,
        rests: bool = True,
    ) -> None:
        """`budget_s`: how long a picture may take; work left by then is given up. Without a budget,
        the work is bounded by counts alone. `rests`: whether not every picture is searched where
        nothing changes. Raises TargetError."""
        self._finders = finders_for(targets)
        self._budget_ns = None if budget_s is None else round(budget_s * 1e9)
        self._clock = clock or SystemClock()
        self._tracks: list[Track] = []
        self._searched_ns: int | None = None
        self._looked_ns = 0
        self._outlines: list[Array] = []
        self._shape: tuple[int, ...] = ()
        self._rests, self._stillness = rests, Stillness()
        self.given_up = 0

    @property
    def misdescribed(self) -> tuple[str, ...]:
        """Boards that the target file describes wrongly by what was seen so far, each once, with
        what to write instead."""
        return misdescribed(self._finders)

    @property
    def located(self) -> tuple[Located, ...]:
        """The faces of the last picture, as they were measured."""
        return tuple(track.located for track in self._tracks if not track.misses)

    def detect(self, picture: np.ndarray, stamp_ns: int) -> tuple[FaceSighting, ...]:
        """The faces in a picture, taken at `stamp_ns`; raises InputError as a detector does."""
        grey = as_grey(picture)
        budget = _Budget(self._clock, self._budget_ns)
        self._forget(grey.shape, stamp_ns)
        followed = self._followed(grey, stamp_ns, budget.is_over)
        found = [located for _, located in followed]
        if self._is_search_due(grey, stamp_ns, found):
            self._searched_ns = stamp_ns
            found = self._searched(grey, found, None, budget.is_over)
            self._looked_ns, self._outlines = stamp_ns, _outlines(found)
        elif budget.is_left() and self._is_look_beside_due(stamp_ns, found):
            for region in regions_around(_outlines(found), grey.shape):
                found = self._searched(grey, found, region, budget.is_over)
            self._looked_ns, self._outlines = stamp_ns, _outlines(found)
        self._tracks = self._renewed(followed, found[len(followed) :], stamp_ns)
        self.given_up += budget.was_over
        return tuple(located.sighting for located in found)

    def _forget(self, shape: tuple[int, ...], stamp_ns: int) -> None:
        """Drop outdated tracks; all of them if time runs backwards or the picture size changes."""
        if shape != self._shape or any(track.seen_ns >= stamp_ns for track in self._tracks):
            self._tracks, self._searched_ns = [], None
        self._shape = shape
        self._tracks = [t for t in self._tracks if stamp_ns - t.seen_ns <= FORGET_NS]

    def _is_search_due(self, grey: np.ndarray, stamp_ns: int, found: Sequence[Located]) -> bool:
        """Whether to search all: nothing is followed in pictures that change, a face was just lost,
        or it is time to."""
        if self._tracks:
            self._stillness = Stillness()
        fresh = sum(track.misses == 0 for track in self._tracks)
        if self._searched_ns is None or len(found) < fresh:
            return True
        if not found and not (self._rests and self._stillness.lasts(grey, stamp_ns)):
            return True
        return stamp_ns - self._searched_ns >= SEARCH_EVERY_NS

    def _is_look_beside_due(self, stamp_ns: int, found: Sequence[Located]) -> bool:
        """Whether it is time and a face has moved: a standing robot shows no other face."""
        if stamp_ns - self._looked_ns < SEARCH_BESIDE_EVERY_NS:
            return False
        return any(
            all(_has_moved(last, outline) for last in self._outlines)
            for outline in _outlines(found)
        )

    def _followed(
        self, grey: np.ndarray, stamp_ns: int, is_over: IsOver
    ) -> list[tuple[Track, Located]]:
        """The followed faces, found within reach of their predictions."""
        followed: list[tuple[Track, Located]] = []
        for track in self._tracks:
            located = self._where_expected(grey, track, stamp_ns, is_over)
            if located is not None and not _is_among(located, [other for _, other in followed]):
                followed.append((track, located))
        return followed

    def _where_expected(
        self, grey: np.ndarray, track: Track, stamp_ns: int, is_over: IsOver
    ) -> Located | None:
        fit = track.fit_at(stamp_ns)
        last = track.located
        is_sure = track.is_steady and track.change is not None
        for is_there in (True, False) if is_sure else (False,):
            if is_over():
                break
            reach = 0.0 if is_there else track.reach_px(fit)
            located = self._finder(last).follow(grey, last, fit, reach_px=reach, is_over=is_over)
            if located is not None:
                return located
        return None

    def _searched(
        self, grey: np.ndarray, found: list[Located], within: Region | None, is_over: IsOver
    ) -> list[Located]:
        """The found faces plus those that a search of the picture, or of a region, adds."""
        found = list(found)
        left = _covered(grey, found)
        for finder in self._finders.values():
            if is_over():
                break
            new = finder.locate(left, is_over, within)
            found += [located for located in new if not _is_among(located, found)]
        return found

    def _renewed(
        self, followed: list[tuple[Track, Located]], new: list[Located], stamp_ns: int
    ) -> list[Track]:
        """Tracks of the faces followed, of those that a search found, and of those just missed."""
        tracks = [track.renewed(located, stamp_ns) for track, located in followed]
        left = [t for t in self._tracks if all(t is not track for track, _ in followed)]
        for located in new:
            last = next((t for t in left if _is_same(t, located, stamp_ns)), None)
            if last is None:
                tracks.append(Track(located, stamp_ns, None))
            else:
                left.remove(last)
                tracks.append(last.renewed(located, stamp_ns))
        return tracks + [replace(t, misses=t.misses + 1) for t in left if t.misses < MOST_MISSES]

    def _finder(self, located: Located) -> FaceFinder:
        return self._finders[located.look.face.pattern]


class _Budget:
    """The time budget of one picture."""

    def __init__(self, clock: Clock, budget_ns: int | None) -> None:
        self._clock = clock
        self._end_ns = (
            None if budget_ns is None else clock.elapsed_ns() + round(LAST_BEGIN * budget_ns)
        )
        self.was_over = False

    def is_left(self) -> bool:
        """Whether there is time for deferrable work; skipping that does not count as giving up."""
        return self._end_ns is None or self._clock.elapsed_ns() <= self._end_ns

    def is_over(self) -> bool:
        """Whether the budget is nearly used up; called before every step of a search."""
        self.was_over = not self.is_left()
        return self.was_over


def _is_among(located: Located, found: Sequence[Located]) -> bool:
    """Whether a face is one of these: the only one of its look, or in the same place."""
    for other in found:
        if other.look is not located.look:
            continue
        if located.look.is_unique or located.found.is_near(other.found):
            return True
    return False


def _is_same(track: Track, located: Located, stamp_ns: int) -> bool:
    """Whether a face that a search found belongs to a track."""
    if track.located.look is not located.look:
        return False
    if located.look.is_unique:
        return True
    points = track.seen_points
    off = located.found.fit.project(points) - track.fit_at(stamp_ns).project(points)
    reach = 0.5 * track.located.found.extent + LEAST_REACH_PX
    return bool(np.all(np.abs(off.mean(axis=0)) < reach))


def _covered(grey: np.ndarray, found: Sequence[Located]) -> np.ndarray:
    """The picture with the found faces painted over."""
    if not found:
        return grey
    left = grey.copy()
    level = median(grey[::_COARSE, ::_COARSE].reshape(-1))
    for outline in _outlines(found):
        cv2.fillConvexPoly(left, np.rint(outline).astype(np.int32), (level,))
    return left


def _has_moved(last: Array, outline: Array) -> bool:
    """Whether an outline (4, 2) has moved from the last one."""
    return bool(np.abs(outline - last).max() > MOVED_SHARE * np.ptp(outline, axis=0).max())


def _outlines(found: Sequence[Located]) -> list[Array]:
    """Outlines (n, 2) of faces, pixels, without degenerate projections."""
    outlines = [face.found.fit.project(CornerPattern.of(face.look.face).outline) for face in found]
    return [outline for outline in outlines if np.abs(outline).max() < _FAR_PX]
