"""Finds the sightings of a standing robot that only repeat earlier ones of the same standstill.

Errors of corners are partly systematic and stay while a robot stands (decisions/0604), so a
standstill's pictures soon tell nothing new; but a robot may stand before a camera for days. So a
fixed number of pictures is kept for each look of the robot. A robot that was put elsewhere, a
camera that was moved, or a face that appears is another look.

Of a target that several robots carry, any of them may be seen. How they drive tells them apart:
what looks alike is another look after any of them has moved; what does not is a new standstill.
"""

from collections.abc import Iterable, Mapping

import numpy as np
from msgspec import Struct

from trigpoint.fusion.model.gates import SAME_CORNER_SIGMAS
from trigpoint.fusion.model.observations import Observation, View
from trigpoint.fusion.model.odometry import OdometryTrack
from trigpoint.geometry.samples import median

from .admission import Budget

MOST_ALIKE = 64
"""How many pictures of one look are kept. Where their errors have a systematic part of variance b²,
in units of the noise's, the mean of these has b² + 1/64, and that of all would have b²."""
# A standstill may have so many looks, and one more an hour: a camera that trembles would produce
# ever new ones.
_MOST_LOOKS = 16
_LOOKS_HZ = 1 / 3600
# It takes so many common corners to tell whether a face is where it was.
_LEAST_CORNERS = 4


class _Standstill(Struct):
    """A robot, or one of several, before a camera, until the last picture of it. `views`: its
    present look; `count`: how many pictures of that look were kept; `kept`: the budget for all
    looks."""

    last_ns: int
    views: tuple[View, ...]
    kept: Budget
    count: int = 0


class Standstills:
    """The standstills of every robot before every camera. Not thread-safe. `tracks`: the robots'
    odometry."""

    def __init__(self, tracks: Mapping[str, OdometryTrack]) -> None:
        self._tracks = tracks
        self._found: dict[tuple[str, tuple[str, ...]], _Standstill] = {}

    def repeats(self, observation: Observation) -> bool:
        """Whether an observation only repeats earlier ones; to be asked in the order in which they
        come."""
        robot, views = (observation.robot,), observation.views
        return self.shown_again(observation.camera, robot, observation.stamp_ns, views)

    def shown_again(
        self, camera: str, robots: tuple[str, ...], stamp_ns: int, views: tuple[View, ...]
    ) -> bool:
        """`repeats` for views that may be of any of `robots`; to be asked in the same order."""
        found, have_stood = self._going_on(camera, robots, stamp_ns, views)
        if found is None:
            kept = Budget(_LOOKS_HZ * MOST_ALIKE, _MOST_LOOKS * MOST_ALIKE)
            self._found[camera, robots] = _Standstill(stamp_ns, views, kept, count=1)
            return not kept.takes(stamp_ns, stamp_ns)
        found.last_ns = max(found.last_ns, stamp_ns)
        new = tuple(v for v in views if not any(_common(v, w) for w in found.views))
        has_moved = any(v not in new and not _is_alike(v, found.views) for v in views)
        count = 0 if has_moved or new or not have_stood else found.count
        if count >= MOST_ALIKE or not found.kept.takes(stamp_ns, stamp_ns):
            return True
        found.views = views if has_moved else (*found.views, *new)
        found.count = count + 1
        return False

    def _going_on(
        self, camera: str, robots: tuple[str, ...], stamp_ns: int, views: tuple[View, ...]
    ) -> tuple[_Standstill | None, bool]:
        """The standstill that views belong to, if any, and whether all robots have stood since its
        last picture."""
        found = self._found.get((camera, robots))
        if found is None:
            return None, True
        if all(self._has_stood(robot, found.last_ns, stamp_ns) for robot in robots):
            return found, True
        may_be_another = len(robots) > 1 and all(_is_alike(view, found.views) for view in views)
        return (found if may_be_another else None), False

    def _has_stood(self, robot: str, since_ns: int, stamp_ns: int) -> bool:
        """Whether a robot has stood since a moment, as far as its odometry reaches."""
        track = self._tracks[robot]
        if not len(track):
            return True
        first_ns, last_ns = track.first_ns, track.last_ns
        ends_ns = (min(max(ns, first_ns), last_ns) for ns in sorted((since_ns, stamp_ns)))
        return track.is_still(*ends_ns)


_Rows = np.ndarray | slice


def _common(view: View, other: View) -> tuple[_Rows, _Rows] | None:
    """Where each of two views has the corners that both have; None where they cannot be compared:
    of two faces, or with hardly a corner in common."""
    if view.readings != other.readings:
        return None
    least = min(_LEAST_CORNERS, len(view.corners))
    if view.corners.tobytes() == other.corners.tobytes():
        return slice(None), slice(None)
    _, mine, theirs = np.intersect1d(view.corners, other.corners, return_indices=True)
    return (mine, theirs) if len(mine) >= least else None


def _is_alike(view: View, others: Iterable[View]) -> bool:
    """Whether a view shows its face at the same place as one of the others."""
    return any(_is_at_one_place(view, other) for other in others)


def _is_at_one_place(view: View, other: View) -> bool:
    common = _common(view, other)
    if common is None:
        return False
    mine, theirs = common
    pixels = [view.pixels[mine]]
    if any(reading.is_turned for reading in view.readings):
        pixels.append(pixels[0][::-1])  # it may be read from either end
    most = SAME_CORNER_SIGMAS * max(view.sigma, other.sigma)
    apart = (each - other.pixels[theirs] for each in pixels)
    return any(median(np.hypot(*each.T)) <= most for each in apart)
