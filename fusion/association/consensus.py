"""Where the search for a visit's modes starts: camera poses that single sightings show, ranked by
how many other sightings of the visit agree.

Every way to read a sighting gives a pose of the camera relative to the robot in that picture, and
odometry relates the robot's poses in all pictures of the visit. So each such pose predicts what
every other sighting should show. A start takes the sightings that contradict it to be wrong from
the beginning, so that these outliers do not bias the mode that it leads to. (RANSAC, except that
every sample is tried and each is judged by its own covariance; Fischler and Bolles, 1981.)
"""

import numpy as np
from msgspec import Struct

from trigpoint.fusion.model.assembly import lens_sigmas
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.drift import Drift
from trigpoint.fusion.model.observations import Observation
from trigpoint.fusion.model.thinning import thinned
from trigpoint.fusion.reading.faces import are_same_pose
from trigpoint.fusion.reading.views import BODY, VIEWS, body_tables, patterns, view_tables
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.samples import unique
from trigpoint.native.library import In, Kernel, Out

from .events import Events

_LEAST_VARIANCE = 1e-12
# Starts come from at most this many sightings, spread over a visit: one of them is taken to be
# right.
MOST_SEEDS = 8
_REAL = np.float64
_WAYS = Kernel(
    "tp_ways",
    *(In(_REAL, ("p",)), *BODY, In(np.int64, ("f",)), *VIEWS),
    *(In(_REAL, ("s",)), In(_REAL, (3,))),
    *(Out(np.int64, ("w",)), Out(_REAL, ("w", 12)), Out(_REAL, ("w", 6, 6)), Out(_REAL, ("w",))),
)
_COSTS = Kernel(
    "tp_start_costs",
    *(In(np.int64, ("n",)), In(np.int64, ("n",)), In(_REAL, ("n", 3, 3)), In(_REAL, ("n", 3))),
    *(In(_REAL, ("n", 6, 6)), In(_REAL, ("n",)), In(np.int64, ("s",))),
    *(
        In(_REAL, ("p", 3, 3)),
        In(_REAL, ("p", 3)),
        In(_REAL, ("p", 6, 6)),
        In(_REAL, ("p", "p", 36)),
    ),
    *(float, float),
    Out(_REAL, ("s", "v")),
)


class Start(Struct, frozen=True):
    """A camera pose to start from. `wrong` (v,): which views of all pictures are taken to be
    wrong."""

    map_from_camera: Pose
    wrong: np.ndarray


class Ways(Struct, frozen=True):
    """All ways (n) to read single sightings, each by itself.

    `sighting` (n,), `picture` (n,): which ones a way is of; `camera_from_base` (n): the pose that
    it shows, with its `covariance` (n, 6, 6) in the camera's axes; `excess` (n,): by how much χ²
    its fit is worse than the best way to read the same sighting.
    """

    sighting: np.ndarray
    picture: np.ndarray
    camera_from_base: Pose
    covariance: Array
    excess: Array


def starts_of(
    data: DataSet,
    observations: dict[int, Observation],
    poses: dict[int, Pose],
    drift: Array,
    events: Events,
    *,
    most: int,
    window: float,
) -> list[Start]:
    """Return the starts with which most sightings agree, best first: at most `most`, none worse
    than the best by more than `window`, and no two with both the same pose and the same wrong
    sightings.

    `poses`: by index, where odometry puts the robot; `drift` (p, p, 6, 6): the covariance of
    odometry between each two pictures, in the map's axes.
    """
    ways = _ways(data, observations)
    if ways is None:
        return []
    there = Pose.stack(list(poses.values()))
    seeds, limit = _seeds(ways), events.wrong_limit
    cameras = there[ways.picture[seeds]] @ ways.camera_from_base[seeds].inverse()
    first = next(iter(observations.values()))
    extra = _of_pictures(data, first, observations, there)
    count = sum(len(observation.views) for observation in observations.values())
    cost = start_costs(ways, seeds, count, there, extra, drift, events)
    total = cost.sum(axis=1) + ways.excess[seeds]
    found: list[Start] = []
    is_open = np.ones(len(cameras), dtype=bool)
    for row in np.argsort(total, kind="stable"):
        if len(found) == most or total[row] > total.min() + window:
            break
        if is_open[row]:
            is_wrong = cost >= limit
            alike = np.all(is_wrong == is_wrong[row], axis=1)
            is_open &= ~(alike & are_same_pose(cameras, cameras[row]))
            found.append(Start(cameras[row], is_wrong[row]))
    return found


def start_costs(
    ways: Ways,
    seeds: np.ndarray,
    sightings: int,
    there: Pose,
    extra: Array,
    drift: Array,
    events: Events,
) -> Array:
    """Return the cost (s, v) of each of the sightings (v) where the camera is where each of the
    `seeds` (s,), rows of the ways, puts it: by the way to read it that agrees best; that of a wrong
    one where none agrees better.

    `there` (p): the robot in each picture by odometry; `extra` (p, 6, 6), `drift` (p, p, 6, 6): the
    covariances of its deviation from that, and of odometry between two pictures.
    """
    costs = np.empty((len(seeds), sightings))
    _COSTS(
        *(ways.sighting, ways.picture, ways.camera_from_base.rotation),
        *(ways.camera_from_base.translation, ways.covariance, ways.excess, seeds),
        *(there.rotation, there.translation, extra, drift.reshape(len(there), -1, 36)),
        *(events.wrong_limit, events.pose_score, costs),
    )
    return costs


def _seeds(ways: Ways) -> np.ndarray:
    """Return the rows (s,) of the ways to read at most `MOST_SEEDS` sightings, spread over the
    visit."""
    sightings = unique(ways.sighting)
    sightings = sightings[thinned(len(sightings), MOST_SEEDS)]
    return np.flatnonzero(np.isin(ways.sighting, sightings))


def _ways(data: DataSet, observations: dict[int, Observation]) -> Ways | None:
    """Return all ways to read each sighting; their covariances are due to the corners, the lens,
    and the mounting of the faces."""
    first = next(iter(observations.values()))
    views = [view for observation in observations.values() for view in observation.views]
    owner = np.repeat(np.arange(len(observations)), [len(o.views) for o in observations.values()])
    target, lens = data.targets[first.robot], data.lenses[first.camera]
    config, fusion = data.site.cameras[first.camera], data.site.fusion
    spread = lens_sigmas(config, lens) if config.estimates_intrinsics else np.zeros(0)
    shift, turn = fusion.target_translation**2, fusion.target_rotation**2
    tables = view_tables(views)
    most = 2 * len(tables[-1])
    sighting, rows = np.empty(most, dtype=np.int64), np.empty((most, 12))
    covariance, excess = np.empty((most, 6, 6)), np.empty(most)
    count = _WAYS(
        *(lens.parameters, *body_tables(target), patterns(target), *tables),
        *(spread, np.array([shift + _LEAST_VARIANCE, turn + _LEAST_VARIANCE, turn])),
        *(sighting, rows, covariance, excess),
    )
    if count == 0:
        return None
    seen = sighting[:count]
    poses = Pose.from_rows(rows[:count])
    return Ways(seen, owner[seen], poses, covariance[:count], excess[:count])


def _of_pictures(
    data: DataSet, first: Observation, observations: dict[int, Observation], there: Pose
) -> Array:
    """Return the covariance (p, 6, 6), in the map's axes, of the robot's pose in each picture about
    odometry's: tilt and sway, and its motion over the uncertain time offset of the camera."""
    extra = np.tile(_LEAST_VARIANCE * np.eye(6), (len(observations), 1, 1))
    jitter = data.jitter.get(first.robot)
    if jitter is not None:
        extra += np.diag(jitter.variances)
    offset_s = data.site.cameras[first.camera].time_offset_sigma
    if offset_s > 0:
        track = data.tracks[first.robot]
        stamps = np.array([o.stamp_ns for o in observations.values()])
        inside = np.clip(stamps, track.first_ns, track.last_ns)
        _, twist = track.carried(inside, np.zeros(len(inside)), np.zeros(2))
        moving = (there.rotation[:, None] @ twist.reshape(-1, 2, 3, 1)).reshape(-1, 6)
        extra += offset_s**2 * moving[:, :, None] * moving[:, None]
    return extra


def drift_between(data: DataSet, robot: str, stamps_ns: np.ndarray, there: Pose) -> Array:
    """Return the covariance (p, p, 6, 6), in the map's axes, of odometry's pose in the later of
    each two pictures given the earlier; `there` (p): odometry's poses."""
    track, noise = data.tracks[robot], data.site.robots[robot].odometry
    moments, rows = np.unique(
        np.clip(stamps_ns, track.first_ns, track.last_ns), return_inverse=True
    )
    sigma = np.array([noise.distance_scale, noise.heading_scale])
    at = np.array([int(np.argmax(rows == step)) for step in range(len(moments))])
    drift = Drift.of(track, moments, np.zeros(2), there[at])
    earlier, later = np.minimum.outer(rows, rows), np.maximum.outer(rows, rows)
    noisy, by_scale = drift.between(earlier, later)
    scaled = by_scale * sigma
    return noisy + scaled @ np.swapaxes(scaled, -1, -2)
