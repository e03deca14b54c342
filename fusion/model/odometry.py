"""One robot's odometry, and the motion between any two moments of it with its uncertainty.

The noise is the contract's random walk (`trigpoint.contract.odometry_noise`). Between two messages
the robot is taken to move with a constant twist, so a fraction of an increment has that fraction of
the increment's twist and of its variance. The core takes messages in (`rest.cpp`, which has
LONGEST_GAP_S as GAP_NS) and composes the motion (`odometry.cpp`).
"""

import bisect
import copy
from collections.abc import Iterable
from enum import IntEnum

import numpy as np
from numpy.linalg import LinAlgError

from trigpoint.base.clock import to_ns
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.site.config import OdometryNoise

from . import odometry_kernels
from .motion import STILL, Motion, both, composed, moved
from .readings import Readings
from .rest import Rest

PARTS = (
    "distance",
    "lateral",
    "vertical",
    "heading_drive",
    "heading_turn",
    "tilt",
    "tilt_turn",
)
"""The parts of the stated noise, without the scales."""
PLANAR = [0, 1, 5]
SPATIAL = [0, 1, 2, 3, 4, 5]

# No robot exceeds these, m/s and rad/s, unless its site file says more: a larger step means that
# its counters restarted or that it was carried, and says nothing about where it is.
_FASTEST = 5.0, 20.0
# A robot that moves less in a second stands, or turns.
_LEAST_WAY_M = 0.1
# Over a longer gap in its odometry a robot is not taken to drive straight between the ends.
LONGEST_GAP_S = 1.0
# This many messages of a standstill are kept individually (20 s at 50 Hz); later ones are merged
# into a single step without motion, whose end moves on.
MOST_STANDING = 1024
# A robot that turns also slips sideways, which the contract's model leaves out: with no translation
# reported there would be no translation noise at all, and real robots contradict that.
SLIP = 0.001  # m per √rad
_ARRAYS = ("_stamps", "_rotations", "_translations", "_twists", "_jumps", "_gaps")


class Added(IntEnum):
    """The outcome of adding an odometry message: taken; not newer than the last one; taken, but it
    jumps or comes after a gap, so that the motion before it is unknown."""

    TAKEN = 0
    STALE = -1
    JUMP = 1


class OdometryTrack:
    """The odometry of one robot so far. Not thread-safe.

    `slip`, `skid`: noise added to the contract's, m per √rad turned, along both axes of the plane
    and along the track alone; `scales`: the scale errors by which the reports were corrected.
    """

    def __init__(
        self,
        noise: OdometryNoise,
        *,
        planar: bool,
        slip: float = SLIP,
        fastest: tuple[float, float] = _FASTEST,
    ) -> None:
        """`fastest`: how fast the robot may drive, m/s, and turn, rad/s."""
        self.noise, self.planar, self.slip, self.skid = noise, planar, slip, 0.0
        self._fastest = np.maximum(_FASTEST, fastest)
        self.scales = (0.0, 0.0)
        self._count = 0
        self._stamps = np.zeros(1024, dtype=np.int64)
        self._rotations = np.zeros((1024, 3, 3))
        self._translations = np.zeros((1024, 3))
        self._twists = np.zeros((1024, 6))  # of the increment that ends at the row
        self._jumps = np.zeros(1024, dtype=bool)
        self._jump_rows: list[int] = []
        self._broken_rows: list[int] = []  # those that odometry itself does not show
        self._gaps = np.zeros(1024)  # path that may have been driven unseen up to the row, metres
        self._rest = Rest(planar=planar)
        self.reported = Pose.identity()
        """The last reading as the robot gave it."""
        self._period_ns = 0  # from the message before the last to the last
        self._standing = 0  # messages since the robot moved last

    def __len__(self) -> int:
        return self._count

    @property
    def tangent(self) -> list[int]:
        """Indices of the free components of a pose's disturbance (6,)."""
        return PLANAR if self.planar else SPATIAL

    @property
    def stamps_ns(self) -> np.ndarray:
        """The stamps of the messages, (n,) int64."""
        return self._stamps[: self._count]

    @property
    def odom_from_base(self) -> Pose:
        """The reported poses (n), without the noise of standing."""
        return Pose(self._rotations[: self._count], self._translations[: self._count])

    @property
    def first_ns(self) -> int:
        return int(self._stamps[0])

    @property
    def last_ns(self) -> int:
        return self._stamps.item(self._count - 1)

    @property
    def leap_count(self) -> int:
        """How many messages lie, or turn, farther from the one before than any robot does."""
        leaps = self._jumps[: self._count] & (self._gaps[: self._count] == 0)
        leaps[self._broken_rows] = False
        return int(np.count_nonzero(leaps))

    @property
    def break_count(self) -> int:
        """In how many steps the robot was moved, which odometry does not show."""
        return len(self._broken_rows)

    @property
    def way(self) -> tuple[float, float]:
        """How far the robot drove along and across its axis, m: second by second, in which noise
        cancels, and of no second in which it hardly moved."""
        if not self._count:
            return 0.0, 0.0
        seconds = (self.stamps_ns - self.first_ns) // to_ns(1.0)
        starts = np.flatnonzero(np.diff(seconds, prepend=-1))
        led = np.abs(np.add.reduceat(self._twists[: self._count, :2], starts))
        along, across = led[led.max(axis=1) > _LEAST_WAY_M].sum(axis=0).tolist()
        return along, across

    def covers(self, stamp_ns: int) -> bool:
        """Whether the robot's motion is known at this moment."""
        return self._count > 0 and self.first_ns <= stamp_ns <= self.last_ns

    def add(self, stamp_ns: int, odom_from_base: Pose) -> Added:
        """Append a message; one that is not newer than the last is refused.

        Once the robot has stood for long, the last message is moved on instead.
        """
        one = Readings(np.array([stamp_ns]), Pose.stack([odom_from_base]))
        return Added(self.add_run(one)[0])

    def add_run(self, readings: Readings) -> list[int]:
        """Append messages, one after the other; what became of each, `Added`."""
        stamps_ns, poses = readings.stamps_ns, readings.odom_from_base
        self._grow(len(readings))
        state = np.array([self._count, self._period_ns, self._standing])
        parts = map(np.ascontiguousarray, (poses.rotation, poses.translation))
        reported, became = Pose(np.empty((3, 3)), np.empty(3)), np.empty_like(stamps_ns)
        tables = (getattr(self, name) for name in _ARRAYS)
        taken = odometry_kernels.ADDED(
            *(self._rest, self.planar, MOST_STANDING, self._fastest, state, *tables),
            *(stamps_ns, *parts),
            *(reported.rotation, reported.translation, became),
        )
        self._count, self._period_ns, self._standing = state.tolist()
        if taken:
            self.reported = reported
        self._jump_rows += became[became > 0].tolist()
        return np.sign(became).tolist()

    def _stands(self, row: int) -> bool:
        """Whether the robot is known not to have moved in the step that ends at a row."""
        if self._jumps[row] or self._gaps[row]:
            return False
        return bool(np.abs(self._twists[row]).max() < STILL)

    def forget_before(self, stamp_ns: int) -> None:
        """Drop what lies before the last message at or before a moment."""
        first = max(int(np.searchsorted(self.stamps_ns, stamp_ns, "right")) - 1, 0)
        for name in _ARRAYS:  # copies of this track share the old ones
            setattr(self, name, getattr(self, name)[first:].copy())
        self._count -= first
        self._twists[0], self._jumps[0], self._gaps[0] = 0.0, False, 0.0
        self._jump_rows = [row - first for row in self._jump_rows if row > first]
        self._broken_rows = [row - first for row in self._broken_rows if row > first]

    def break_between(self, after_ns: int, before_ns: int) -> None:
        """Mark the motion as unknown between two moments, where the robot was moved and odometry
        does not show it.

        The break is put into a step in which the robot stood, where there is one.
        """
        self._split(after_ns)
        self._split(before_ns)
        first = int(np.searchsorted(self.stamps_ns, after_ns, "left")) + 1
        last = int(np.searchsorted(self.stamps_ns, before_ns, "right")) - 1
        if first > last:  # no whole step lies between them
            first = last = int(np.clip(last + 1, 1, self._count - 1))
        still = np.abs(self._twists[first : last + 1]).max(axis=1) < STILL
        row = last - int(np.argmax(still[::-1]))
        if not self._jumps[row]:
            self._jumps[row] = True
            bisect.insort(self._jump_rows, row)
            self._broken_rows = [*self._broken_rows, row]

    def _split(self, stamp_ns: int) -> None:
        """Insert a message at a moment within a long step in which the robot stood."""
        row = int(np.searchsorted(self.stamps_ns, stamp_ns))
        if not 0 < row < self._count or self._stamps[row] == stamp_ns or not self._stands(row):
            return
        if self._stamps[row] - self._stamps[row - 1] <= to_ns(LONGEST_GAP_S):
            return
        # New arrays, since copies of this track share the old ones.
        for name in _ARRAYS:
            array = getattr(self, name)
            setattr(self, name, np.insert(array, row, array[row], axis=0))
        self._stamps[row] = stamp_ns
        self._count += 1
        self._jump_rows = [r + (r >= row) for r in self._jump_rows]
        self._broken_rows = [r + (r >= row) for r in self._broken_rows]

    def mended(self) -> "OdometryTrack":
        """A copy of the odometry so far without breaks, so that others can be marked in it."""
        track = copy.copy(self)
        track._jumps, track._jump_rows = self._jumps.copy(), list(self._jump_rows)
        track.mend()
        return track

    def noisy(self, noise: OdometryNoise, *, slip: float, skid: float) -> "OdometryTrack":
        """A read-only copy of the odometry so far with other noise."""
        track = copy.copy(self)
        track.noise, track.slip, track.skid = noise, slip, skid
        return track

    def scaled(self, scales: Array) -> "OdometryTrack":
        """A read-only copy of the odometry so far, corrected for these scale errors (2,) of
        distance and heading."""
        track = self.retold(np.diag(both(1 + scales)))
        distance, heading = ((1 + np.array(self.scales)) * (1 + scales) - 1).tolist()
        track.scales = distance, heading
        return track

    def retold(self, by_twist: Array) -> "OdometryTrack":
        """A read-only copy with each step's twist mapped by (6, 6), or by its own (n, 6, 6)."""
        track = copy.copy(self)
        track._twists = (by_twist @ self._twists[: self._count, :, None])[..., 0]
        path = composed(moved(track._twists[1 : self._count])) if self._count else Pose.identity()
        poses = self.odom_from_base[:1] @ path
        track._rotations, track._translations = poses.rotation, poses.translation
        return track

    def mend(self) -> None:
        """Remove every break."""
        self._jumps[self._broken_rows] = False
        self._jump_rows = [row for row in self._jump_rows if row not in self._broken_rows]
        self._broken_rows = []

    def pieces(self, stamps_ns: np.ndarray) -> np.ndarray:
        """The number (n,) of jumps and breaks before each of the moments (n,)."""
        return np.searchsorted(self._stamps[self._jump_rows], stamps_ns, "right")

    @property
    def jump_steps(self) -> tuple[tuple[int, int], ...]:
        """The steps in which the motion is unknown, each from one message's stamp to another's, in
        order."""
        rows = np.array(self._jump_rows, dtype=int)
        return tuple(zip(self._stamps[rows - 1].tolist(), self._stamps[rows].tolist(), strict=True))

    def jump_in(self, steps: Iterable[tuple[int, int]]) -> None:
        """Break the track in these steps, from one message's stamp to another's, and nowhere else;
        jumps that odometry itself shows remain."""
        self.mend()
        ends_ns = []
        for start_ns, end_ns in steps:
            self._split(start_ns)
            self._split(end_ns)
            ends_ns.append(end_ns)
        rows = np.searchsorted(self.stamps_ns, ends_ns).tolist()
        self._broken_rows = sorted(set(rows) - set(self._jump_rows))
        for row in self._broken_rows:
            self._jumps[row] = True
            bisect.insort(self._jump_rows, row)

    def _grow(self, more: int) -> None:
        """Have room for so many more messages."""
        while self._count + more > len(self._stamps):
            for name in _ARRAYS:
                array = getattr(self, name)
                setattr(self, name, np.concatenate([array, np.zeros_like(array)]))

    def carried(self, stamps_ns: np.ndarray, seconds: Array, scales: Array) -> tuple[Pose, Array]:
        """The robot's motion from moments (n,) during seconds (n,), backwards where negative.

        Returns start_from_end (n) and the twist at the end (n, 6), in its base frame. Beyond the
        odometry's ends, and across a jump, its last motion is extrapolated.
        """
        way, twists = np.empty((len(seconds), 12)), np.zeros((len(seconds), 6))
        if self._count < 2:
            return Pose.identity().repeated(len(seconds)), twists
        moments = np.ascontiguousarray(stamps_ns), np.ascontiguousarray(seconds, dtype=float)
        odometry_kernels.CARRIED(
            *self._tables, *moments, np.array(scales, dtype=float), way, twists
        )
        return Pose.from_rows(way), twists

    def twists_about(self, stamps_ns: np.ndarray) -> Array:
        """The robot's mean twists (n, 6) about moments (n,), in its base frame, over 2 ms to either
        side, but not across a jump: less than between messages, and more than a camera's time
        offset still changes by once all else is known."""
        twists = np.zeros((len(stamps_ns), 6))
        if self._count > 1:
            odometry_kernels.TWISTS_ABOUT(*self._tables, np.ascontiguousarray(stamps_ns), twists)
        return twists

    def is_in_gap(self, stamp_ns: int) -> bool:
        """Whether a moment lies in a gap of the odometry, so that the motion to it is not known."""
        row = int(np.searchsorted(self.stamps_ns, stamp_ns))
        is_between = 0 < row < self._count and self._stamps[row] != stamp_ns
        return bool(is_between and self._gaps[row] > 0)

    def is_still(self, start_ns: int, end_ns: int) -> bool:
        """Whether the robot did not move between two moments that odometry covers."""
        if start_ns >= end_ns:
            return True
        first, last = np.searchsorted(self.stamps_ns, [start_ns, end_ns], "right")
        if np.any(np.abs(self._twists[first + 1 : last]) >= STILL):
            return False  # some whole step moved: quickly seen over a long time
        return bool(self.motion(np.array([start_ns, end_ns]), np.zeros(2)).is_still[0])

    def motion(self, stamps_ns: np.ndarray, scales: Array) -> Motion:
        """Motion between consecutive moments (n + 1, ascending, covered by the odometry).

        `scales`: (2,) constant scale errors of distance and heading; true = (1 + error) · reported.
        """
        count = len(stamps_ns) - 1
        ways, covariance, by_scale = (np.empty((count, *of)) for of in ((12,), (6, 6), (6, 2)))
        is_still = np.empty(count, dtype=bool)
        odometry_kernels.MOTION(
            *(*self._tables, np.ascontiguousarray(stamps_ns)),
            *(*self._noise, np.array(scales, dtype=float)),
            *(ways, covariance, by_scale, is_still),
        )
        return Motion(Pose.from_rows(ways), covariance, by_scale, is_still)

    def carried_on(
        self, start_ns: int, end_ns: int, scales: Array, pose: Pose, covariance: Array
    ) -> tuple[Pose, Array]:
        """The robot's pose at a later moment by the motion in between, and the covariance (6, 6) of
        its disturbance, from those at a moment; `scales` as for `motion`, and taken as known."""
        end, spread = np.empty((1, 12)), np.empty((6, 6))
        odometry_kernels.CARRIED_ON(
            *(*self._tables, start_ns, end_ns, *self._noise, np.array(scales, dtype=float)),
            *(pose.rows(), np.ascontiguousarray(covariance), end, spread),
        )
        return Pose.from_rows(end)[0], spread

    def step(
        self, start_ns: int, end_ns: int, scales: Array, start: Pose, end: Pose
    ) -> tuple[Array, Array, Array]:
        """What the motion between two moments makes of the disturbance of the robot's pose, to
        first order about poses at both: matrix (d, d + 2), shift (d,) and noise (d, d).

        With the disturbance δ (d,) of the start in the free directions and the change s (2,) of the
        scales that of the end is matrix · (δ, s) + shift, and noise of that covariance. Raises
        LinAlgError where the motion's covariance is not positive definite.
        """
        d = len(self.tangent)
        matrix, shift, noise = np.empty((d, d + 2)), np.empty(d), np.empty((d, d))
        is_determined = odometry_kernels.STEP(
            *(*self._tables, start_ns, end_ns, *self._noise, np.array(scales, dtype=float)),
            *(start.rows(), end.rows(), np.array(self.tangent, dtype=np.int64)),
            *(matrix, shift, noise),
        )
        if not is_determined:
            raise LinAlgError("a motion's covariance is not positive definite")
        return matrix, shift, noise

    @property
    def _noise(self) -> tuple[np.ndarray, float, float]:
        """Parts of the noise (7,), slip and skid."""
        parts = np.array([getattr(self.noise, part) for part in PARTS], dtype=float)
        return parts, float(self.slip), float(self.skid)

    @property
    def _tables(self) -> tuple[np.ndarray, ...]:
        """The messages as the core takes them: `Track` of `odometry.cpp`."""
        rows = slice(self._count)
        return (
            *(self._stamps[rows], self._rotations[rows], self._translations[rows]),
            *(self._twists[rows], self._jumps[rows], self._gaps[rows]),
        )
