"""Poses of robots and cameras at past moments, by what any estimator knows now; and whether a
robot's motion, as other cameras saw it at the time, explains a visit to one more camera.

Poses are computed from an estimator's results and the odometry, with an upper bound of the error
rather than the exact covariance. But two robots that report the same motion do not move
identically: what a second camera saw meanwhile tells them apart far better than odometry. So a
visit is solved together with all that located cameras saw of the robot at the time, and the χ² that
it adds is the evidence against that robot.
"""

import numpy as np
from msgspec.structs import replace
from numpy.linalg import LinAlgError

from trigpoint.base.clock import to_ns
from trigpoint.fusion.estimators.interface import CameraEstimate, Live, Trajectory
from trigpoint.fusion.model.assembly import assemble
from trigpoint.fusion.model.dataset import DataSet, Entry
from trigpoint.fusion.model.gates import HUBER_SIGMAS
from trigpoint.fusion.model.observations import Verdict
from trigpoint.fusion.model.problem import CameraState, State
from trigpoint.fusion.solver.filter import RobotEstimate
from trigpoint.fusion.solver.levenberg_marquardt import solve
from trigpoint.geometry import Pose

# A decimetre and a tenth of a radian: the error that an incomplete solution may have.
_FLOOR = np.diag(np.repeat([0.1**2, 0.1**2], 3))
_BESIDE_NS = to_ns(1.0)
_TOLERANCE = 1e-2


class PastPoses:
    """A snapshot of the moment at which it is made."""

    def __init__(self, data: DataSet, estimator: Live) -> None:
        self._data, self._estimator = data, estimator
        self._cameras = estimator.cameras()
        self._ways: dict[str, Trajectory | None] = {}
        self._seen: dict[str, np.ndarray] = {}

    def camera(self, name: str) -> CameraEstimate | None:
        """A camera's pose; None where it is not known."""
        return self._cameras.get(name)

    def robot(self, name: str, stamp_ns: int) -> RobotEstimate | None:
        """A robot's pose; None where odometry does not connect the moment to a known pose."""
        track = self._data.tracks[name]
        if not len(track) or not track.covers(stamp_ns):
            return None
        if name not in self._ways:
            self._ways[name] = self._estimator.trajectory(name)
            self._seen[name] = self._seen_ns(name)
        way = self._ways[name]
        if way is not None:
            return self._on_way(name, way, stamp_ns)
        last = self._estimator.robot(name)
        if last is None or not track.covers(last.stamp_ns):
            return None
        pose = self._carried(name, last.map_from_base, last.stamp_ns, stamp_ns)
        return self._drifted(name, pose, stamp_ns, last.stamp_ns, last.covariance)

    def _on_way(self, name: str, way: Trajectory, stamp_ns: int) -> RobotEstimate | None:
        """From the estimator's whole trajectory, taken as certain where the robot was seen."""
        seen = self._seen[name]
        if not len(way.stamps_ns) or not len(seen):
            return None
        row = int(np.argmin(np.abs(way.stamps_ns - stamp_ns)))
        near_ns = int(seen[np.argmin(np.abs(seen - stamp_ns))])
        pose = self._carried(name, way.map_from_base[row], int(way.stamps_ns[row]), stamp_ns)
        return self._drifted(name, pose, stamp_ns, near_ns, np.zeros((6, 6)))

    def _seen_ns(self, name: str) -> np.ndarray:
        """The times (n,) at which a robot's pose was known without its odometry."""
        track = self._data.tracks[name]
        stamps = [
            entry.observation.stamp_ns
            for entry in self._data.entries
            if entry.observation.robot == name and entry.observation.verdict is Verdict.ACCEPTED
        ]
        origin = [track.first_ns] if name == self._data.anchored_robot else []
        return np.clip(np.array([*origin, *stamps], dtype=np.int64), track.first_ns, track.last_ns)

    def _carried(self, name: str, pose: Pose, from_ns: int, to_ns: int) -> Pose:
        """A pose propagated forwards or backwards by odometry."""
        if from_ns == to_ns:
            return pose
        moments = np.array(sorted([from_ns, to_ns]))
        moved = self._data.tracks[name].motion(moments, np.zeros(2)).earlier_from_later[0]
        return pose @ (moved if from_ns < to_ns else moved.inverse())

    def _drifted(
        self, name: str, pose: Pose, stamp_ns: int, known_ns: int, covariance: np.ndarray
    ) -> RobotEstimate | None:
        """The estimate with odometry's drift since a moment added; None across a break of it."""
        track, covariance = self._data.tracks[name], covariance + _FLOOR
        moments = np.array(sorted([known_ns, stamp_ns]))
        if len(set(track.pieces(moments).tolist())) > 1:
            return None
        if known_ns != stamp_ns:
            drift = np.diagonal(track.motion(moments, np.zeros(2)).covariance[0])
            covariance = covariance + np.diag(np.repeat([drift[:3].sum(), drift[3:].sum()], 3))
        return RobotEstimate(stamp_ns, pose, covariance)

    def added_chi2(self, camera: str, state: CameraState, visit: list[Entry]) -> float:
        """χ² that a visit (read, with poses) to a camera, assumed at `state`, adds to what the
        located cameras saw of its robot then; infinite where it cannot be solved.

        All these cameras are free, so that only what they saw in that time counts.
        """
        robot = visit[0].observation.robot
        cameras = {
            name: CameraState(known.map_from_camera, known.lens, known.time_offset_s)
            for name, known in self._cameras.items()
        }
        stamps = [entry.observation.stamp_ns for entry in visit]
        beside = [
            entry
            for entry in self._data.entries
            if entry.observation.robot == robot
            and entry.observation.verdict is Verdict.ACCEPTED
            and entry.observation.camera in cameras
            and entry.map_from_base is not None
            and min(stamps) - _BESIDE_NS <= entry.observation.stamp_ns <= max(stamps) + _BESIDE_NS
        ]
        try:
            without = _chi2(self._data, cameras, beside) if beside else 0.0
            together = _chi2(self._data, {**cameras, camera: state}, [*beside, *visit])
        except LinAlgError:
            return np.inf
        return together - without if np.isfinite(without) else np.inf


def _chi2(data: DataSet, cameras: dict[str, CameraState], entries: list[Entry]) -> float:
    small = replace(data, entries=sorted(entries, key=lambda entry: entry.observation.stamp_ns))
    start = State(cameras, data.first_state().robots)
    assembled = assemble(small, start, list(range(len(entries))), anchored=False)
    cost = solve(assembled.problem, assembled.start, huber=HUBER_SIGMAS, tolerance=_TOLERANCE).cost
    return cost if np.isfinite(cost) else np.inf
