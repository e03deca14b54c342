"""Visits: runs of pictures of one robot by one camera between which odometry hardly drifts."""

from collections.abc import Set

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.observations import Observation
from trigpoint.fusion.model.thinning import thinned
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.samples import median

# Within a visit odometry must tell faces of a target apart (a sixth of a turn), and places to less
# than a tenth of the camera's distance.
_DRIFT_M = 0.15
_DRIFT_RAD = 0.1
# A visit also ends where its robot is out of sight for longer than this, or than so many times the
# median interval between pictures: nothing was observed meanwhile.
_LONGEST_GAP_NS = 20_000_000_000
_LONGEST_GAP_PERIODS = 50
# So many pictures of a visit determine its modes; the others are then read by these.
_MOST_VIEWS = 12
# So many visits of each robot, of so many pictures at least, tell a session's noise and scales well
# enough.
_MOST_TELLING = 6
_LEAST_TO_TELL = 3


class Visit(Struct, frozen=True):
    """One visit. `indices`: of its pictures in the session's observations, in order of time;
    `chosen`: those that the search uses; `stamp_ns`: of the first of these, whose robot pose is the
    visit's own frame; `until_ns`: of the last of these."""

    camera: str
    robot: str
    indices: tuple[int, ...]
    chosen: tuple[int, ...]
    stamp_ns: int
    until_ns: int

    def part(self, observations: list[Observation], start: int, end: int | None) -> "Visit":
        """The visit of only its pictures from `start` up to, without, `end`; None: to the last."""
        return visit_of(observations, list(self.indices[start:end]))

    def within(self, observations: list[Observation], start: int, end: int) -> "Visit":
        """The visit with all its pictures, of which only those in a part are chosen from."""
        return replace(self.part(observations, start, end), indices=self.indices)


def visits_of(data: DataSet, observations: list[Observation]) -> list[Visit]:
    """All visits, in order of their first pictures."""
    by_pair: dict[tuple[str, str], list[int]] = {}
    for index, observation in enumerate(observations):
        by_pair.setdefault((observation.camera, observation.robot), []).append(index)
    found = []
    for (camera, robot), indices in by_pair.items():
        stamps = np.array([observations[i].stamp_ns for i in indices])
        ends = {*_ends(data, robot, stamps), *_moved(data, camera, stamps)}
        runs = np.split(np.array(indices), sorted(ends))
        found += [visit_of(observations, run.tolist()) for run in runs]
    return sorted(found, key=lambda visit: (visit.stamp_ns, visit.camera))


def visit_of(
    observations: list[Observation], indices: list[int], *, most: int = _MOST_VIEWS
) -> Visit:
    """The visit of these pictures, of which at most `most`, evenly spread, are chosen."""
    first, last = observations[indices[0]], observations[indices[-1]]
    chosen = [indices[i] for i in thinned(len(indices), most)]
    return Visit(
        first.camera, first.robot, tuple(indices), tuple(chosen), first.stamp_ns, last.stamp_ns
    )


def telling(visits: list[Visit]) -> list[Visit]:
    """For every robot, its visits with the most pictures."""
    found: list[Visit] = []
    for robot in dict.fromkeys(visit.robot for visit in visits):
        mine = [v for v in visits if v.robot == robot and len(v.indices) >= _LEAST_TO_TELL]
        found += sorted(mine, key=lambda visit: -len(visit.indices))[:_MOST_TELLING]
    return found


def telling_of_lenses(visits: list[Visit], cameras: Set[str]) -> list[Visit]:
    """For each of these cameras, its visit with the most pictures, if these suffice for a lens."""
    longest: dict[str, Visit] = {}
    for visit in sorted(visits, key=lambda visit: len(visit.indices)):
        if visit.camera in cameras and len(visit.indices) >= _LEAST_TO_TELL:
            longest[visit.camera] = visit
    return list(longest.values())


def _moved(data: DataSet, camera: str, stamps_ns: np.ndarray) -> list[int]:
    """The rows of moments (n,) with which a camera begins or ends to be moved, as was told."""
    told = [move for move in data.told if move.camera == camera]
    begins = np.searchsorted(stamps_ns, [move.until_ns for move in told], side="right")
    ends = np.searchsorted(stamps_ns, [move.since_ns for move in told])
    rows = np.concatenate([begins, ends]).astype(int).tolist()
    return [row for row in rows if 0 < row < len(stamps_ns)]


def _ends(data: DataSet, robot: str, stamps_ns: np.ndarray) -> list[int]:
    """The rows of moments (n,) with which a new visit begins."""
    track = data.tracks[robot]
    moments, row_of = np.unique(
        np.clip(stamps_ns, track.first_ns, track.last_ns), return_inverse=True
    )
    if len(moments) < 2:
        return []
    gaps = np.diff(moments)
    is_away = gaps > min(_LONGEST_GAP_NS, _LONGEST_GAP_PERIODS * median(gaps))
    pieces = track.pieces(moments)
    ends = []
    # Between the runs nothing need be known of the motion.
    runs = np.split(np.arange(len(moments)), np.flatnonzero(is_away) + 1)
    for run in runs:
        rows = [int(run[0])] if run[0] else []
        if len(run) > 1:
            rows += _ends_of_run(data, robot, moments[run], pieces[run], int(run[0]))
        ends += [int(np.argmax(row_of == row)) for row in rows]
    return ends


def _ends_of_run(
    data: DataSet, robot: str, moments: np.ndarray, pieces: np.ndarray, first: int
) -> list[int]:
    """The rows, counted from `first`, of moments (n,) with which a new visit begins, since odometry
    has drifted since the visit's first; `pieces`: of the odometry, (n,)."""
    track, noise = data.tracks[robot], data.site.robots[robot].odometry
    motion = track.motion(moments, np.zeros(2))
    variances = np.diagonal(motion.covariance, axis1=1, axis2=2)[:, track.tangent]
    half = (len(track.tangent) + 1) // 2  # shifts, then turns
    lengths = np.linalg.norm(motion.earlier_from_later.translation, axis=1)
    turns = np.linalg.norm(so3.log(motion.earlier_from_later.rotation), axis=1)
    steps = np.stack(
        [
            variances[:, :half].sum(axis=1) + (noise.distance_scale * lengths) ** 2,
            variances[:, half:].sum(axis=1) + (noise.heading_scale * turns) ** 2,
        ],
        axis=1,
    )
    ends, drift, since = [], np.zeros(2), 0
    for row in range(1, len(moments)):
        drift = drift + steps[row - 1]
        far = drift[0] > _DRIFT_M**2 or drift[1] > _DRIFT_RAD**2
        if far or pieces[row] != pieces[since]:
            ends.append(first + row)
            drift, since = np.zeros(2), row
    return ends
