"""What the pictures leave open of a lifted robot's map, asked by who knows the truth.

A robot that is lifted between two visits, and then meets only cameras that it has not met before,
shows nothing of it until it comes back to one that it has. Everything that it met in between hangs
on one side of the lift or on the other, according to when that was; where another moment explains
all pictures as well as the true one, nobody can know where those cameras are. A bound that takes
the moment as known does not say so; studies ask here.
"""

from itertools import pairwise

import numpy as np
from msgspec.structs import replace

from trigpoint.base.clock import to_ns
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.gates import DECISIVE
from trigpoint.fusion.model.observations import Observation
from trigpoint.fusion.reading.faces import is_same_pose
from trigpoint.fusion.solver.levenberg_marquardt import Solution, solve
from trigpoint.geometry import Pose
from trigpoint.tools.networks.cramer_rao import Oracle, oracle_problem

# Within a visit a jump shows; where nothing sees the robot for so long, it may have been lifted.
_UNSEEN_NS = to_ns(1.0)
_TOLERANCE = 1e-3


def left_open(data: DataSet, oracle: Oracle) -> set[str]:
    """The cameras that stand elsewhere if a robot was lifted at another moment, where χ² tells that
    from the true moment by less than 25; arguments as `cramer_rao`'s."""
    lifts = [(robot, number) for robot, at in oracle.lifted_ns.items() for number in range(len(at))]
    if not lifts:
        return set()
    truth = solved(data, oracle)
    found: set[str] = set()
    for robot, number in lifts:
        for moment_ns in _moments(oracle, robot):
            rival = solved(data, _lifted_at(data, oracle, robot, number, moment_ns))
            if rival.cost - truth.cost < DECISIVE:
                found |= _elsewhere(truth, rival)
    return found


def solved(data: DataSet, oracle: Oracle) -> Solution:
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
