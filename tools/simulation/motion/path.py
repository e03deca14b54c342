"""The path of a robot: straight lines and arcs through waypoints, at one speed."""

import numpy as np
from msgspec import Struct
from numpy.typing import ArrayLike

from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array, wrap


class Path(Struct, frozen=True, eq=False):
    """Pieces of constant curvature one after the other, looking along the way.

    `starts`: (n, 3) x, y, heading where each piece begins; `distances`: (n + 1,) metres to each
    piece's beginning, and the whole length; `curvatures`: (n,) 1/m, 0 for a straight line.
    """

    starts: Array
    distances: Array
    curvatures: Array

    @property
    def length(self) -> float:
        """Metres."""
        return float(self.distances[-1])

    def at(self, distance: ArrayLike) -> Pose:
        """Poses `distance` (…) metres along the path, held at both ends."""
        s = np.clip(np.asarray(distance, dtype=float), 0.0, self.length)
        piece = np.clip(
            np.searchsorted(self.distances, s, side="right") - 1, 0, len(self.starts) - 1
        )
        along, k = s - self.distances[piece], self.curvatures[piece]
        x, y, heading = np.moveaxis(self.starts[piece], -1, 0)
        turn = along * k
        # The chord of an arc points half the turn to the side; np.sinc(a) is sin(πa)/(πa).
        chord = along * np.sinc(turn / (2 * np.pi))
        middle = heading + turn / 2
        return Pose.planar(x + chord * np.cos(middle), y + chord * np.sin(middle), heading + turn)


class Drive(Struct, frozen=True):
    """A path in time: stand, speed up, drive on without a stop, slow down, stand."""

    path: Path
    speed: float
    acceleration: float
    start_s: float

    @property
    def end_s(self) -> float:
        """When the robot stands again."""
        peak = self._peak
        ramps = peak / self.acceleration
        return self.start_s + ramps + self.path.length / peak

    def at(self, t_s: ArrayLike) -> Pose:
        """The pose at world time `t_s` (…), seconds."""
        t = np.asarray(t_s, dtype=float) - self.start_s
        peak = self._peak
        ramp = peak / self.acceleration
        total = self.end_s - self.start_s
        from_start = 0.5 * self.acceleration * np.clip(t, 0.0, ramp) ** 2
        cruise = peak * (np.clip(t, ramp, total - ramp) - ramp)
        slowing = np.clip(t - (total - ramp), 0.0, ramp)
        return self.path.at(
            from_start + cruise + slowing * (peak - 0.5 * self.acceleration * slowing)
        )

    @property
    def _peak(self) -> float:
        """The speed that is reached; a short path never comes to the full one."""
        return min(self.speed, float(np.sqrt(self.acceleration * self.path.length)))


def rounded_path(waypoints: ArrayLike, radius: float) -> Path:
    """A path through waypoints (n, 2) whose corners are arcs of `radius` metres, or less where the
    legs beside a corner are too short."""
    points = np.asarray(waypoints, dtype=float)
    legs = np.diff(points, axis=0)
    lengths = np.linalg.norm(legs, axis=1)
    if np.any(lengths < 1e-6):
        raise ValueError("two waypoints in a row are the same; remove one")
    headings = np.arctan2(legs[:, 1], legs[:, 0])
    turns = wrap(np.diff(headings))
    if np.any(np.abs(turns) > np.radians(175)):
        raise ValueError("the path turns back on the spot; put a waypoint beside it")
    half = np.tan(np.abs(turns) / 2)
    cuts = np.minimum(radius * half, 0.5 * np.minimum(lengths[:-1], lengths[1:]))
    return _pieces(points, headings, lengths, turns, cuts)


def _pieces(points: Array, headings: Array, lengths: Array, turns: Array, cuts: Array) -> Path:
    """`cuts`: (n - 2,) how much of the legs beside each corner its arc takes, metres."""
    starts, sizes, curvatures = [], [], []
    before = 0.0
    for i, heading in enumerate(headings):
        direction = np.array([np.cos(heading), np.sin(heading)])
        after = float(cuts[i]) if i < len(cuts) else 0.0
        starts.append([*(points[i] + before * direction), heading])
        sizes.append(lengths[i] - before - after)
        curvatures.append(0.0)
        if after > 0:
            arc_radius = after / np.tan(abs(turns[i]) / 2)
            starts.append([*(points[i + 1] - after * direction), heading])
            sizes.append(arc_radius * abs(turns[i]))
            curvatures.append(np.sign(turns[i]) / arc_radius)
        before = after
    distances = np.concatenate([[0.0], np.cumsum(sizes)])
    return Path(np.array(starts), distances, np.array(curvatures))
