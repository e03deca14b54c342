"""Poses that a robot can probably drive to, and the length of the way there.

The floor is known by where robots have driven: squares within half a metre of their ways, joined to
their neighbours. A robot that does not move in a plane is only sent where one of its kind was.
"""

import numpy as np
from msgspec import Struct

from trigpoint.fusion.model.places import are_near, path_lengths
from trigpoint.fusion.model.thinning import thinned
from trigpoint.fusion.solver.snapshot import GuidanceWorld, RobotPlace
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.samples import unique

CELL_M = 0.25
DRIVEN_M = 0.5
"""The largest distance of a suggestion from a pose that was driven."""
SEEN_M = 1.0
"""The largest distance, from where a camera saw a target, at which it should see one again."""
_HEADINGS = 12
_MOST_PLACES = 24  # for each camera
_LARGEST_GAP_M = 3.0  # between two poses of a way; beyond it the robot's odometry jumped
_DETOUR = 1.5  # a goal that no known way leads to


class Ground(Struct, frozen=True):
    """`squares`: (n, 2) int, their middles in units of a side; `poses`: all that were driven,
    (m)."""

    squares: np.ndarray
    poses: Pose

    @classmethod
    def of(cls, world: GuidanceWorld) -> "Ground":
        driven = np.concatenate([np.zeros((0, 2)), *(_dense(w) for w in world.ways.values())])
        return cls(_squares(driven), Pose.joined(world.ways.values()))

    @property
    def places(self) -> Array:
        """The middles of the squares, (n, 2)."""
        return self.squares * CELL_M

    def paths_from(self, here: Pose) -> Array:
        """The length of the way to each square, (n,), metres."""
        start = here.translation[:2]
        straight = np.linalg.norm(self.places - start, axis=1)
        if not len(straight):
            return straight
        paths = CELL_M * path_lengths(self.squares, int(np.argmin(straight)))
        return np.where(np.isfinite(paths), np.maximum(paths, straight), _DETOUR * straight)


class Candidates(Struct, frozen=True):
    """`map_from_base` (n), and how long the way there is (n,), metres."""

    map_from_base: Pose
    path_m: Array

    def where(self, chosen: np.ndarray) -> "Candidates":
        return Candidates(self.map_from_base[chosen], self.path_m[chosen])


def nearest_cameras(
    world: GuidanceWorld, ground: Ground, paths: Array, *, without: str, most: int
) -> list[str]:
    """The cameras that have seen a target, nearest to the robot first."""
    places, found = ground.places, []
    if not len(places):
        return []
    for name, views in world.views.items():
        if name != without and len(views.places):
            some = views.places[thinned(len(views.places), 16), :2]
            squares = np.argmin(np.linalg.norm(some[:, None] - places, axis=2), axis=1)
            found.append((float(paths[squares].min()), name))
    return [name for _, name in sorted(found)[:most]]


def candidates(
    world: GuidanceWorld, ground: Ground, paths: Array, place: RobotPlace, cameras: list[str]
) -> Candidates:
    """Poses at which these cameras may see the robot; a bounded number."""
    if not place.planar:
        return _driven(ground, place.map_from_base)
    near = [_near(ground.places, world.views[name].places[:, :2]) for name in cameras]
    chosen = unique(np.concatenate([np.zeros(0, dtype=int), *near]))
    x, y = np.repeat(ground.places[chosen], _HEADINGS, axis=0).T
    headings = np.tile(np.arange(_HEADINGS) * 2 * np.pi / _HEADINGS, len(chosen))
    return Candidates(Pose.planar(x, y, headings), np.repeat(paths[chosen], _HEADINGS))


def _near(places: Array, seen: Array) -> np.ndarray:
    """Indices of squares near where a camera saw a target, spread evenly over them."""
    near = np.flatnonzero(are_near(places, seen, SEEN_M))
    return near[thinned(len(near), _MOST_PLACES)]


def _driven(ground: Ground, here: Pose) -> Candidates:
    poses = ground.poses[thinned(len(ground.poses), _HEADINGS * _MOST_PLACES)]
    return Candidates(poses, np.linalg.norm(poses.translation - here.translation, axis=1))


def _dense(way: Pose) -> Array:
    """A way's places, interpolated, (n, 2)."""
    places = way.translation[:, :2]
    if len(places) < 2:
        return places
    lengths = np.linalg.norm(np.diff(places, axis=0), axis=1)
    counts = np.where(lengths <= _LARGEST_GAP_M, np.ceil(lengths / CELL_M), 1).astype(int)
    counts = np.maximum(counts, 1)
    start = np.repeat(np.arange(len(counts)), counts)
    offset = np.arange(len(start)) - np.repeat(np.cumsum(counts) - counts, counts)
    share = (offset / counts[start])[:, None]
    between = places[start] * (1 - share) + places[start + 1] * share
    return np.concatenate([between, places[-1:]])


def _squares(driven: Array) -> np.ndarray:
    """All squares (n, 2) whose middles are within reach of driven places (m, 2), in lexical
    order."""
    reach = int(np.ceil(DRIVEN_M / CELL_M))
    around = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 2), axis=-1).reshape(-1, 2)
    own = unique(np.round(driven / CELL_M).astype(int), axis=0)
    squares = unique((own[:, None] + around).reshape(-1, 2), axis=0)
    return squares[are_near(squares * CELL_M, driven, DRIVEN_M)]
