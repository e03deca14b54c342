"""What the pictures leave open of a map, asked by who knows the truth.

A robot that is lifted between two visits, and then meets only cameras that it has not met before,
shows nothing of it until it comes back to one that it has. Everything that it met in between hangs
on one side of the lift or on the other, according to when that was; where another moment explains
all pictures as well as the true one, nobody can know where those cameras are. Nor where all that a
camera saw of one robot, another one with the same target explains as well by its odometry, with the
camera elsewhere. A bound that takes the moment and the robots as known does not say so; studies ask
here.
"""

from collections.abc import Iterator
from itertools import chain, combinations, pairwise, product

import numpy as np
from msgspec.structs import replace

from trigpoint.base.clock import to_ns
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.gates import DECISIVE
from trigpoint.fusion.model.motion import composed
from trigpoint.fusion.model.observations import Observation
from trigpoint.fusion.reading.faces import is_same_pose
from trigpoint.fusion.solver.levenberg_marquardt import Solution, solve
from trigpoint.geometry import Pose
from trigpoint.tools.networks.cramer_rao import Oracle, oracle_problem

# Within a visit a jump shows; where nothing sees the robot for so long, it may have been lifted.
_UNSEEN_NS = to_ns(1.0)
# A camera that saw nothing for longer sees the next robot, or the same one again.
_AWAY_NS = to_ns(2.0)
_TOLERANCE = 1e-3


def left_open(data: DataSet, oracle: Oracle) -> set[str]:
    """The cameras that stand elsewhere in another explanation of all pictures, where χ² tells that
    from the truth by less than 25; arguments as `cramer_rao`'s."""
    truth, found = None, set[str]()
    for rival, candidates in chain(_by_lifts(data, oracle), _by_robots(data, oracle)):
        if candidates <= found:
            continue
        truth, other = truth or _solved(data, oracle), _solved(data, rival)
        if other.cost - truth.cost < DECISIVE:
            found |= candidates & _elsewhere(truth, other)
    return found


def _by_lifts(data: DataSet, oracle: Oracle) -> Iterator[tuple[Oracle, set[str]]]:
    """Those in which a robot was lifted at another moment; any camera may be elsewhere then."""
    for robot, lifts in oracle.lifted_ns.items():
        for number in range(len(lifts)):
            for moment_ns in _moments(oracle, robot):
                yield _lifted_at(data, oracle, robot, number, moment_ns), set(oracle.cameras)


def _solved(data: DataSet, oracle: Oracle) -> Solution:
    """All good sightings explained as an oracle would have it."""
    assembled = oracle_problem(data, oracle)
    return solve(assembled.problem, assembled.start, tolerance=_TOLERANCE)


def _moments(oracle: Oracle, robot: str) -> list[int]:
    """The middle of every gap in which nothing saw a robot and it was not truly lifted."""
    stamps = np.unique([o.stamp_ns for o, _ in oracle.places if o.robot == robot])
    lifted = np.array(oracle.lifted_ns[robot])
    return [
        early + (late - early) // 2
        for early, late in pairwise(stamps.tolist())
        if late - early > _UNSEEN_NS and not np.any((lifted > early) & (lifted <= late))
    ]


def _lifted_at(data: DataSet, oracle: Oracle, robot: str, number: int, moment_ns: int) -> Oracle:
    """The same with one of a robot's lifts at another moment: what it did between the two, and the
    cameras that it met only then, move as a whole to where odometry leads."""
    lifts = list(oracle.lifted_ns[robot])
    lift_ns, lifts[number] = lifts[number], moment_ns
    early, late = sorted([lift_ns, moment_ns])
    shift = _jump(data, oracle, robot, lift_ns)
    shift = shift if moment_ns > lift_ns else shift.inverse()

    def is_between(observation: Observation) -> bool:
        return observation.robot == robot and early <= observation.stamp_ns < late

    places = [(o, shift @ pose if is_between(o) else pose) for o, pose in oracle.places]
    inside = {o.camera for o, _ in places if is_between(o)}
    inside -= {o.camera for o, _ in places if not is_between(o)}
    cameras = {
        name: replace(c, map_from_camera=shift @ c.map_from_camera) if name in inside else c
        for name, c in oracle.cameras.items()
    }
    return replace(
        oracle,
        cameras=cameras,
        places=places,
        lifted_ns={**oracle.lifted_ns, robot: sorted(lifts)},
    )


def _jump(data: DataSet, oracle: Oracle, robot: str, lift_ns: int) -> Pose:
    """What brings the places after a lift to where the robot's odometry leads from those before."""
    seen = sorted((o.stamp_ns, n) for n, (o, _) in enumerate(oracle.places) if o.robot == robot)
    before = max(item for item in seen if item[0] < lift_ns)
    after = min(item for item in seen if item[0] >= lift_ns)
    moments = np.array([before[0], after[0]])
    driven = data.tracks[robot].motion(moments, np.zeros(2)).earlier_from_later[0]
    places = [pose for _, pose in oracle.places]
    return places[before[1]] @ driven @ places[after[1]].inverse()


def _elsewhere(truth: Solution, rival: Solution) -> set[str]:
    there = rival.state.cameras
    return {
        name
        for name, camera in truth.state.cameras.items()
        if not is_same_pose(camera.map_from_camera, there[name].map_from_camera)
    }


def _by_robots(data: DataSet, oracle: Oracle) -> Iterator[tuple[Oracle, set[str]]]:
    """Those in which a camera is elsewhere, and other robots with the same target, one a visit, are
    what it saw; or two such cameras together. With these: all others may drift with what is
    measured, but hang where they do."""
    cameras = dict.fromkeys(seen.camera for seen, _ in oracle.places)
    alone = {c: _rivals(data, oracle, c) for c in cameras if c not in data.known.poses}
    rivals = {camera: found for camera, found in alone.items() if found}
    for camera, those in rivals.items():
        yield from ((rival, {camera}) for rival in those)
    for first, second in combinations(rivals, 2):
        for one in rivals[first]:
            for rival in _rivals(data, one, second, as_in=oracle):
                yield rival, {first, second}


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
