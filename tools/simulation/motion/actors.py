"""The cameras and robots of a simulated world, and what may befall them on the way."""

import numpy as np
from msgspec import Struct
from numpy.typing import ArrayLike

from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array
from trigpoint.site.config import OdometryNoise
from trigpoint.site.target import Target

from .odometry import Way, relative
from .path import Drive


class Move(Struct, frozen=True, eq=False):
    """At world time `at_s` a camera is knocked: its pose until then is disturbed by `by` (6,),
    metres and radians in the map's axes, by the contract's convention."""

    at_s: float
    by: Array


class Lift(Struct, frozen=True):
    """At world time `at_s` a robot is lifted, and put down where its drive would have had it
    `skip_s` seconds later; its wheels turn on, so its odometry shows nothing of it."""

    at_s: float
    skip_s: float


class SimulatedCamera(Struct, frozen=True, eq=False):
    """One camera. It takes picture k at `phase + k / rate` seconds. Standard deviations: `blur_px`
    of the lens, `noise` of a grey value (of 255), `sigma` of a coordinate in sightings that are
    simulated without pictures, pixels. `map_from_camera`: where it hangs at first; its stamps are
    `time_offset_s` ahead of the true time; each row is exposed `line_delay_s` after the one above,
    the middle one at the picture's time."""

    name: str
    map_from_camera: Pose
    model: CameraModel
    rate: float
    phase: float
    exposure_s: float
    blur_px: float
    noise: float
    sigma: float
    time_offset_s: float = 0.0
    line_delay_s: float = 0.0
    moves: tuple[Move, ...] = ()

    def time_of(self, index: ArrayLike) -> Array:
        """World time of picture `index`: the middle of its exposure, seconds."""
        return self.phase + np.asarray(index, dtype=float) / self.rate

    def picture_times(self, duration_s: float) -> Array:
        """World times of its pictures (n,) up to the end."""
        count = int(np.floor((duration_s - self.phase) * self.rate)) + 1
        return self.time_of(np.arange(count))

    def row_delay_s(self, v: ArrayLike) -> Array:
        """How long after the picture's time rows v (…) are exposed, seconds."""
        return self.line_delay_s * (np.asarray(v, dtype=float) - (self.model.height - 1) / 2)

    @property
    def open_s(self) -> float:
        """For how long light reaches the picture, from the first row's to the last one's."""
        return self.exposure_s + abs(self.line_delay_s) * (self.model.height - 1)

    def map_from_camera_at(self, t_s: float) -> Pose:
        """Where it hangs at a world time."""
        pose = self.map_from_camera
        for move in self.moves:
            if t_s >= move.at_s:
                pose = pose.disturbed(move.by)
        return pose

    def between_moves(self, times_s: Array) -> list[Array]:
        """World times (n,), rising, cut where it is moved; no part is empty."""
        cuts = np.searchsorted(times_s, sorted(move.at_s for move in self.moves))
        return [part for part in np.split(times_s, cuts) if len(part)]


class SimulatedRobot(Struct, frozen=True, eq=False):
    """One robot: its drive in the map, and how it reports it. `target`: what its target file says;
    `mounted`: where its faces really are, where that differs. The drive is the truth, and the
    report scatters about it; where there is a `way`, that is the truth and the drive is reported.
    """

    name: str
    target: Target
    drive: Drive
    map_from_plan: Pose
    odometry_rate: float
    odometry_start: Pose
    noise: OdometryNoise
    mounted: Target | None = None
    lifts: tuple[Lift, ...] = ()
    way: Way | None = None

    @property
    def carried(self) -> Target:
        """The target as it really is."""
        return self.mounted if self.mounted is not None else self.target

    def map_from_base(self, t_s: ArrayLike) -> Pose:
        """The true pose at world time `t_s`, one or (n,)."""
        return self.way.at(t_s) if self.way is not None else self.planned(t_s)

    def planned(self, t_s: ArrayLike) -> Pose:
        """The pose by its drive at world time `t_s`, one or (n,)."""
        return self.map_from_plan @ self.drive.at(np.asarray(t_s) + self._skipped(t_s))

    def steps(self, stamps_s: Array) -> Array:
        """The drive's motion from stamp to stamp as wheels feel it, in the frame of the earlier
        one; (n - 1, 3) x, y, heading."""
        skipped = self._skipped(stamps_s[:-1])
        before = self.drive.at(stamps_s[:-1] + skipped)
        return relative(before, self.drive.at(stamps_s[1:] + skipped))

    def _skipped(self, t_s: ArrayLike) -> Array:
        """How far ahead of its plan the robot is, seconds, (…)."""
        t = np.asarray(t_s, dtype=float)
        total = np.zeros_like(t)
        for lift in self.lifts:
            total = total + lift.skip_s * (t >= lift.at_s)
        return total
