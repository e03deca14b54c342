"""Which cameras' places are open since several robots carry one target, asked by who knows the
truth.

Where all that a camera saw of one robot, another one's odometry explains as well with the camera
elsewhere, nobody can know which it was, and so not where the camera is. A bound that takes the
robots as known does not say so; studies ask here.
"""

from itertools import combinations, product

import numpy as np
from msgspec.structs import replace

from trigpoint.base.clock import to_ns
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.gates import DECISIVE
from trigpoint.fusion.model.motion import composed
from trigpoint.fusion.reading.faces import is_same_pose
from trigpoint.geometry import Pose
from trigpoint.tools.networks.cramer_rao import Oracle

from .decidable_lifts import solved

# A camera that saw nothing for longer sees the next robot, or the same one again.
_AWAY_NS = to_ns(2.0)


def left_open_by_robots(data: DataSet, oracle: Oracle) -> set[str]:
    """The cameras of which other robots with the same target, one a visit, explain all pictures
    with the camera elsewhere, where χ² tells that from the truth by less than 25; alone, or two
    such cameras together. Arguments as `cramer_rao`'s."""
    if not any(_look_alikes(data, robot) for robot in data.targets):
        return set()
    cameras = dict.fromkeys(seen.camera for seen, _ in oracle.places)
    every = {c: _rivals(data, oracle, c) for c in cameras if c not in data.known.poses}
    rivals = {camera: found for camera, found in every.items() if found}
    if not rivals:
        return set()
    truth, is_open = solved(data, oracle).cost, set[str]()
    for camera, found in rivals.items():
        if any(solved(data, rival).cost - truth < DECISIVE for rival in found):
            is_open.add(camera)
    for first, second in combinations(rivals, 2):
        if not {first, second} <= is_open and any(
            solved(data, rival).cost - truth < DECISIVE
            for one in rivals[first]
            for rival in _rivals(data, one, second, as_in=oracle)
        ):
            is_open |= {first, second}
    return is_open


def _rivals(
    data: DataSet, oracle: Oracle, camera: str, *, as_in: Oracle | None = None
) -> list[Oracle]:
    """The same with a camera elsewhere and all that it saw another robot's, in every way in which
    its visits agree about where it is then; `as_in`: what tells where the robots were."""
    truth = as_in or oracle
    visits = _visits(oracle, camera)
    others = [_look_alikes(data, oracle.places[visit[0]][0].robot) for visit in visits]
    found = (_seen_as(data, oracle, truth, visits, robots) for robots in product(*others))
    return [rival for rival in found if rival is not None]


def _seen_as(
    data: DataSet, oracle: Oracle, truth: Oracle, visits: list[list[int]], robots: tuple[str, ...]
) -> Oracle | None:
    """The same where these robots are what a camera saw on its visits; None where they cannot be,
    with the camera in one place."""
    places, moved = list(oracle.places), list[Pose]()
    camera = places[visits[0][0]][0].camera
    state = oracle.cameras[camera]
    for robot, visit in zip(robots, visits, strict=True):
        if not _is_covered(data, truth, robot, visit):
            return None
        way = _way(data, truth, robot, visit)
        for row, n in enumerate(visit):
            pose = way[row]
            moved.append(pose @ places[n][1].inverse() @ state.map_from_camera)
            places[n] = (replace(places[n][0], robot=robot), pose)
    if not all(is_same_pose(moved[0], pose) for pose in moved[1:]):
        return None
    there = replace(state, map_from_camera=moved[0])
    return replace(oracle, cameras={**oracle.cameras, camera: there}, places=places)


def _visits(oracle: Oracle, camera: str) -> list[list[int]]:
    """The numbers of a camera's observations in order of time, by robot and visit."""
    mine = [n for n, (seen, _) in enumerate(oracle.places) if seen.camera == camera]
    visits: list[list[int]] = []
    last: dict[str, list[int]] = {}
    for n in sorted(mine, key=lambda n: oracle.places[n][0].stamp_ns):
        seen = oracle.places[n][0]
        visit = last.get(seen.robot)
        if visit is None or seen.stamp_ns - oracle.places[visit[-1]][0].stamp_ns > _AWAY_NS:
            visit = last[seen.robot] = []
            visits.append(visit)
        visit.append(n)
    return visits


def _look_alikes(data: DataSet, robot: str) -> list[str]:
    target = data.targets[robot]
    return [name for name, other in data.targets.items() if other == target and name != robot]


def _is_covered(data: DataSet, oracle: Oracle, robot: str, visit: list[int]) -> bool:
    track = data.tracks[robot]
    is_placed = any(seen.robot == robot for seen, _ in oracle.places)
    return is_placed and all(track.covers(oracle.places[n][0].stamp_ns) for n in visit)


def _way(data: DataSet, oracle: Oracle, robot: str, visit: list[int]) -> Pose:
    """Where a robot stood at another one's observations (n): by odometry from its own nearest."""
    stamps = np.array([oracle.places[n][0].stamp_ns for n in visit], dtype=np.int64)
    own = [(seen.stamp_ns, pose) for seen, pose in oracle.places if seen.robot == robot]
    near_ns, near = min(own, key=lambda item: abs(item[0] - int(stamps[0])))
    moments, rows = np.unique(np.append(stamps, near_ns), return_inverse=True)
    path = Pose.stack([Pose.identity()])
    if len(moments) > 1:
        path = composed(data.tracks[robot].motion(moments, np.zeros(2)).earlier_from_later)
    return near @ path[int(rows[-1])].inverse() @ path[rows[:-1]]
