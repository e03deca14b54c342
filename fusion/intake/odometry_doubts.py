"""Odometry that cannot be as the contract has it: what of it is odd, and what that often means.

Told of what came, not guessed: units, axes and the order of a quaternion are the sender's matter.
Pure: no bus, no clock.
"""

from collections.abc import Iterator, Mapping

import numpy as np
from msgspec import Struct

from trigpoint.base.clock import to_ns, to_seconds
from trigpoint.fusion.model.motion import STILL
from trigpoint.fusion.model.odometry import OdometryTrack
from trigpoint.fusion.model.readings import Readings
from trigpoint.geometry.samples import median
from trigpoint.site.config import Site

# The cosine of 30°: no floor on which a robot drives in the plane tilts it so.
_UPRIGHT = 0.87
# Fewer messages say little.
_LEAST = 10
# Nobody drives by odometry that comes more rarely.
_LONGEST_PERIOD_NS = to_ns(5.0)
# Of the messages: odometry restarts, or is sent twice, now and then; of two senders, half are
# stale.
_MOST_JUMPS, _MOST_STALE, _MOST_TILTED = 0.1, 0.4, 0.5
# Of the way, as many of a robot that turns at a point that is not its middle.
_MOST_SIDEWAYS = 0.3
# Of an explanation: a robot is carried once or twice, and not every few minutes.
_MOST_BREAKS, _CARRIED_NS = 2, to_ns(600.0)
_CONVENTION = "x is forward and y left in metres, and headings turn to the left in radians"
_OTHERWISE = f"what cameras saw fits its odometry only if {{}}; {_CONVENTION} (REP 103)"


class _Came(Struct):
    """How many messages of a robot came, and how many of them were not newer than one before, or
    turned out of the plane."""

    count: int = 0
    stale: int = 0
    tilted: int = 0


class OdometryDoubts:
    """What is odd about robots' odometry, by `tracks` and by what `add` was told of.
    `otherwise`: how robots were seen to drive as if theirs were told, in words."""

    def __init__(self, site: Site, tracks: Mapping[str, OdometryTrack]) -> None:
        self._site, self._tracks = site, tracks
        self._came: dict[str, _Came] = {}
        self.otherwise: dict[str, str] = {}

    def add(self, robot: str, readings: Readings, *, stale: int) -> None:
        """Note messages of a robot, of which so many are `stale`: no newer than one before."""
        came = self._came.setdefault(robot, _Came())
        came.count += len(readings)
        came.stale += stale
        uprights = readings.odom_from_base.rotation[:, 2, 2]
        came.tilted += int(np.count_nonzero(uprights < _UPRIGHT))

    @property
    def texts(self) -> list[str]:
        """What is odd, a line each."""
        return [
            f"robot {robot}: {words}"
            for robot, came in self._came.items()
            if robot in self._tracks and came.count >= _LEAST
            for words in (*self._in_messages(robot, came), *self._in_track(robot))
        ]

    @property
    def explain_changes(self) -> bool:
        """Whether every robot's odometry is such that none need have been carried, nor a camera
        moved."""
        tracks = {robot: track for robot, track in self._tracks.items() if len(track)}
        return bool(tracks) and all(
            robot in self.otherwise or _is_stuck(track) for robot, track in tracks.items()
        )

    def _in_track(self, robot: str) -> Iterator[str]:
        if words := self.otherwise.get(robot):
            return iter([_OTHERWISE.format(words)])
        return _in_track(self._tracks[robot])

    def _in_messages(self, robot: str, came: _Came) -> Iterator[str]:
        count, of_all = came.count, f"of {came.count} odometry messages"
        if came.stale > _MOST_STALE * count:
            yield (
                f"{came.stale} {of_all} are stamped no later than one before, and not used; do "
                "their stamps lack the nanoseconds, or do two send them?"
            )
        stamps_ns = self._tracks[robot].stamps_ns
        period_ns = round(median(np.diff(stamps_ns))) if len(stamps_ns) > 1 else 0
        if period_ns > _LONGEST_PERIOD_NS:
            yield (
                f"its {count} odometry messages are {to_seconds(period_ns):.3g} s apart by their "
                "stamps; are the seconds in them milli- or nanoseconds?"
            )
        if self._site.robots[robot].planar and came.tilted > _MOST_TILTED * count:
            yield (
                f"{came.tilted} {of_all} are turned out of the plane by more than 30°; are "
                "quaternions in the order x, y, z, w, and is z upwards? (planar = false for a "
                "robot that does tilt so)"
            )


def _in_track(track: OdometryTrack) -> Iterator[str]:
    if (count := track.leap_count) > _MOST_JUMPS * len(track):
        yield (
            f"{count} of {len(track)} odometry messages lie, or turn, farther from the one before "
            "than any robot does; are its lengths in metres, its headings in radians, and its "
            "stamps right?"
        )
    along, across = track.way
    can_shift = track.noise.lateral >= track.noise.distance
    if not can_shift and across > _MOST_SIDEWAYS * np.hypot(along, across):
        yield (
            f"by its odometry it drove {across:.1f} m sideways and {along:.1f} m along; its axes, "
            f"or the unit or sign of its heading, are wrong: {_CONVENTION} (a robot that can drive "
            "so has odometry.lateral no smaller than odometry.distance in the site file)"
        )
    if _is_stuck(track):
        yield (
            "its odometry does not move while cameras see it in several places: if nobody carried "
            "it, are its encoders connected, and is `topic` the right one?"
        )
        return
    most = max(_MOST_BREAKS, (track.last_ns - track.first_ns) // _CARRIED_NS) if len(track) else 0
    if (breaks := track.break_count) > most:
        yield (
            f"its odometry and what cameras saw agree only if it was carried {breaks} times; if "
            f"nobody did, its odometry is wrong ({_CONVENTION}), or its clock is not the cameras', "
            "or its target file (the faces' places and sizes)"
        )


def _is_stuck(track: OdometryTrack) -> bool:
    """Whether odometry never moves although the robot was seen to, at two times or more."""
    if track.break_count < _MOST_BREAKS:
        return False
    return bool(np.ptp(track.odom_from_base.rows(), axis=0).max() < STILL)
