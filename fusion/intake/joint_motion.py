"""Whether a robot's motion, as other cameras saw it at the time, explains a visit to one more
camera.

Two robots that report the same motion do not move identically: what a second camera saw meanwhile
tells them apart far better than odometry. So a visit is solved together with all that located
cameras saw of the robot at the time, and the χ² that it adds is the evidence against that robot.
"""

import numpy as np
from msgspec.structs import replace
from numpy.linalg import LinAlgError

from trigpoint.base.clock import to_ns
from trigpoint.fusion.model.assembly import assemble
from trigpoint.fusion.model.dataset import DataSet, Entry
from trigpoint.fusion.model.gates import HUBER_SIGMAS
from trigpoint.fusion.model.observations import Verdict
from trigpoint.fusion.model.problem import CameraState, State
from trigpoint.fusion.solver.levenberg_marquardt import solve

_BESIDE_NS = to_ns(1.0)
_TOLERANCE = 1e-2


def added_chi2(
    data: DataSet,
    cameras: dict[str, CameraState],
    camera: str,
    state: CameraState,
    visit: list[Entry],
) -> float:
    """χ² that a visit (read, with poses) to a camera, assumed at `state`, adds to what the located
    `cameras` saw of its robot then; infinite where it cannot be solved.

    All these cameras are free, so that only what they saw in that time counts.
    """
    robot = visit[0].observation.robot
    stamps = [entry.observation.stamp_ns for entry in visit]
    beside = [
        entry
        for entry in data.entries
        if entry.observation.robot == robot
        and entry.observation.verdict is Verdict.ACCEPTED
        and entry.observation.camera in cameras
        and entry.map_from_base is not None
        and min(stamps) - _BESIDE_NS <= entry.observation.stamp_ns <= max(stamps) + _BESIDE_NS
    ]
    try:
        without = _chi2(data, cameras, beside) if beside else 0.0
        together = _chi2(data, {**cameras, camera: state}, [*beside, *visit])
    except LinAlgError:
        return np.inf
    return together - without if np.isfinite(without) else np.inf


def _chi2(data: DataSet, cameras: dict[str, CameraState], entries: list[Entry]) -> float:
    small = replace(data, entries=sorted(entries, key=lambda entry: entry.observation.stamp_ns))
    start = State(cameras, data.first_state().robots)
    assembled = assemble(small, start, list(range(len(entries))), anchored=False)
    cost = solve(assembled.problem, assembled.start, huber=HUBER_SIGMAS, tolerance=_TOLERANCE).cost
    return cost if np.isfinite(cost) else np.inf
