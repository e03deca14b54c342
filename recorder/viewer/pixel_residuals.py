"""Where the faces of a picture should be seen, by where the robots and the camera are said to be.

From what is on the bus alone: fusion's poses with their covariances, the lens, the targets. So a
viewer can say of each sighting how far it is off, and whether these explain that.
"""

from bisect import bisect_left
from collections import deque
from collections.abc import Iterator, Mapping

import numpy as np
from msgspec import Struct

from trigpoint.contract.messages import FaceSighting, PoseEstimate
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array, exp, hat, log
from trigpoint.site.target import Face, Target

_LIMIT = 13.8
"""χ² of two degrees of freedom that one sound sighting in a thousand exceeds."""
_FLOOR_PX = 1.0
"""What is left even where all is known: the lens's model, the print, the clocks."""
_KEPT = 256
_NEAREST_M = 0.05


class Residual(Struct, frozen=True, eq=False):
    """One face: where its corners (n, 2) were seen and are expected; how far their middle is off,
    in pixels and in standard deviations; whether that is more than poses and sigmas explain."""

    seen: Array
    expected: Array
    off_px: float
    off_sigmas: float
    contradicts: bool


class Eye(Struct):
    """A located camera: where it is, and its lens; `time_offset_sigma_s` of its stamps."""

    estimate: PoseEstimate
    lens: CameraModel
    time_offset_sigma_s: float = 0.0


class RobotTrack:
    """The last corrected poses of one robot, in the order of their stamps."""

    def __init__(self) -> None:
        self._stamps: deque[int] = deque(maxlen=_KEPT)
        self._estimates: deque[PoseEstimate] = deque(maxlen=_KEPT)

    def add(self, estimate: PoseEstimate) -> None:
        if not self._stamps or estimate.stamp_ns > self._stamps[-1]:
            self._stamps.append(estimate.stamp_ns)
            self._estimates.append(estimate)

    def covers(self, stamp_ns: int) -> bool:
        """Whether poses from before and after this moment have come."""
        return bool(self._stamps) and self._stamps[0] <= stamp_ns <= self._stamps[-1]

    def at(self, stamp_ns: int) -> tuple[Pose, Array, Array]:
        """map_from_base at a moment that is covered, its covariance (6, 6) and its velocity (6,),
        m/s and rad/s in the map's axes."""
        after = min(max(bisect_left(self._stamps, stamp_ns), 1), len(self._stamps) - 1)
        if len(self._stamps) < 2:
            only = self._estimates[0]
            return only.pose, only.covariance, np.zeros(6)
        first, last = self._estimates[after - 1], self._estimates[after]
        between_s = 1e-9 * (last.stamp_ns - first.stamp_ns)
        part = 1e-9 * (stamp_ns - first.stamp_ns) / between_s
        turn = log(last.pose.rotation @ first.pose.rotation.T)
        shift = last.pose.translation - first.pose.translation
        pose = Pose(exp(part * turn) @ first.pose.rotation, first.pose.translation + part * shift)
        return pose, first.covariance, np.concatenate([shift, turn]) / between_s


def residual_of(
    sighting: FaceSighting,
    stamp_ns: int,
    eye: Eye,
    robots: Mapping[str, RobotTrack],
    targets: Mapping[str, Target],
) -> Residual | None:
    """The reading of a face whose corners are the least off; None where no robot with such a
    target is where it could be seen at that moment."""
    found = [
        residual
        for robot, target in targets.items()
        if robots[robot].covers(stamp_ns) and sighting.target in ("", target.name)
        for face, corners in _readings(sighting, target)
        if (residual := _residual(sighting, face, corners, eye, *robots[robot].at(stamp_ns)))
    ]
    # By corners, not by the middle, which a half turn leaves where it is.
    return min(found, key=lambda one: float(np.sum((one.seen - one.expected) ** 2)), default=None)


def _readings(sighting: FaceSighting, target: Target) -> Iterator[tuple[Face, np.ndarray]]:
    """The faces that it may be, with the corners' ids, either way up where that can be."""
    for face in target.faces:
        if sighting.face not in (-1, face.id) or int(sighting.corners.max()) >= face.corner_count:
            continue
        yield face, sighting.corners
        if face.reads_from_both_ends:
            yield face, face.corner_count - 1 - sighting.corners


def _residual(
    sighting: FaceSighting,
    face: Face,
    corners: np.ndarray,
    eye: Eye,
    map_from_base: Pose,
    covariance: Array,
    velocity: Array,
) -> Residual | None:
    map_from_camera = eye.estimate.pose
    points = map_from_base @ face.base_from_face @ face.corners[corners]
    in_camera = map_from_camera.inverse() @ points
    if np.any(in_camera[:, 2] < _NEAREST_M):
        return None
    expected, by_point = eye.lens.project_by_point(in_camera)
    by_map = by_point @ map_from_camera.rotation.T
    by_robot = _by_pose(by_map, points - map_from_base.translation)
    by_camera = -_by_pose(by_map, points - map_from_camera.translation)
    seen = np.asarray(sighting.pixels, dtype=float)
    off = np.mean(seen - expected, axis=0)
    late = eye.time_offset_sigma_s * (by_robot @ velocity)
    spread = by_robot @ covariance @ by_robot.T
    spread += by_camera @ eye.estimate.covariance @ by_camera.T
    spread += np.outer(late, late) + _FLOOR_PX**2 * np.eye(2)
    chi2 = float(off @ np.linalg.solve(spread, off))
    distance = float(np.linalg.norm(off))
    return Residual(seen, expected, distance, float(np.sqrt(chi2)), chi2 > _LIMIT)


def _by_pose(by_map: Array, arms: Array) -> Array:
    """(2, 6): the corners' mean pixel by the contract's disturbance of a pose; `by_map` (n, 2, 3):
    each pixel by its point in the map; `arms` (n, 3): from the pose's origin to the point."""
    return np.mean(np.concatenate([by_map, -by_map @ hat(arms)], axis=-1), axis=0)
