"""Poses of robots and cameras at past moments, by what any estimator knows now.

Computed from an estimator's results and the odometry, with an upper bound of the error rather than
the exact covariance.
"""

import numpy as np

from trigpoint.fusion.estimators.interface import CameraEstimate, Live, Trajectory
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.observations import Verdict
from trigpoint.fusion.model.problem import CameraState
from trigpoint.fusion.solver.filter import RobotEstimate
from trigpoint.geometry import Pose

# A decimetre and a tenth of a radian: the error that an incomplete solution may have.
_FLOOR = np.diag(np.repeat([0.1**2, 0.1**2], 3))


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

    def camera_states(self) -> dict[str, CameraState]:
        """All cameras that are located."""
        return {
            name: CameraState(camera.map_from_camera, camera.lens, camera.time_offset_s)
            for name, camera in self._cameras.items()
        }

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
