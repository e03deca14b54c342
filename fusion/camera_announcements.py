"""Announcements of the located cameras: their poses, and the floor that they see.

A hundred cameras at once would keep a robot waiting for its correction. So a few are announced a
turn, new ones first, and the floor of one, in turns in which no robot waits.
"""

from collections.abc import Iterator

import numpy as np

from trigpoint.base.clock import to_ns
from trigpoint.contract import topics
from trigpoint.contract.messages import Polygon, PoseEstimate, Transform, Transforms
from trigpoint.geometry import Pose
from trigpoint.site.target import Target

from .coverage.camera_floor import coverage
from .estimators.interface import CameraEstimate
from .output import Output

# Visualisers take a transform for stale that is not repeated within a second.
_PERIOD_NS = to_ns(0.7)
_LONG_NS = to_ns(0.9)  # where there is no quiet turn
_COVERAGE_PERIOD_NS = to_ns(5.0)
# Poses in a turn, and in one in which a robot waits.
_MOST_A_TURN, _MOST_IN_BETWEEN = 8, 1
# A camera that moved less than this still sees the floor that was announced, to within half of the
# decimetres in which that is given.
_SAME_FLOOR_M = 0.05
_SAME_FLOOR_RAD = 0.01


class CameraAnnouncements:
    """The cameras that are to be announced, and those that were. Not thread-safe.

    `target`: the one that the cameras are to see.
    """

    def __init__(self, target: Target) -> None:
        self._target = target
        self._taken_ns: int | None = None
        self._looked_ns: int | None = None
        # What is to be announced, in order; and the pose for which each camera's floor last was.
        self._poses: dict[str, CameraEstimate] = {}
        self._floors: dict[str, CameraEstimate] = {}
        # The last transforms of all; whether they are due though the others are not through.
        self._static: dict[str, Transform] = {}
        self._is_static_due = False
        self._floor_from: dict[str, Pose] = {}

    def is_due(self, stamp_ns: int, *, is_quiet: bool) -> bool:
        """Whether it is time to announce all cameras again; `is_quiet`: no robot waits."""
        return _has_passed(self._taken_ns, stamp_ns, _PERIOD_NS if is_quiet else _LONG_NS)

    def take(self, stamp_ns: int, known: dict[str, CameraEstimate], *, is_urgent: bool) -> None:
        """Set the cameras to announce, as estimated at a moment; `is_urgent`: and every floor that
        changed. One that is no longer located is not announced."""
        self._taken_ns = stamp_ns
        new = {name: one for name, one in known.items() if name not in self._static}
        waiting = {name: known[name] for name in self._poses if name in known}
        self._is_static_due = bool(waiting)
        self._poses = new | waiting | known
        self._static = {name: one for name, one in self._static.items() if name in known}
        self._floors = {name: known[name] for name in self._floors if name in known}
        if is_urgent or _has_passed(self._looked_ns, stamp_ns, _COVERAGE_PERIOD_NS):
            self._looked_ns = stamp_ns
            self._floors |= {n: one for n, one in known.items() if self._sees_another_floor(n, one)}

    def _sees_another_floor(self, name: str, camera: CameraEstimate) -> bool:
        before = self._floor_from.get(name)
        if before is None:
            return True
        pose = camera.map_from_camera
        shift = np.abs(pose.translation - before.translation).max()
        turn = np.abs(pose.rotation - before.rotation).max()
        return bool(shift > _SAME_FLOOR_M or turn > _SAME_FLOOR_RAD)

    def next(self, *, is_quiet: bool) -> Iterator[Output]:
        """What to announce this turn; `is_quiet`: no robot waits."""
        yield from self._say_poses(_MOST_A_TURN if is_quiet else _MOST_IN_BETWEEN)
        if is_quiet:
            yield from self._say_floor()

    def rest(self) -> Iterator[Output]:
        """Everything that is still to be announced."""
        yield from self._say_poses(len(self._poses))
        while self._floors:
            yield from self._say_floor()

    def _say_poses(self, most: int) -> Iterator[Output]:
        transforms, is_new, stamp_ns = [], False, self._taken_ns or 0
        for name in list(self._poses)[:most]:
            camera = self._poses.pop(name)
            pose = camera.map_from_camera
            estimate = PoseEstimate(stamp_ns, "map", pose, camera.covariance)
            yield Output(topics.CAMERA_POSE, name, estimate)
            one = Transform(stamp_ns, "map", f"{name}/optical", pose)
            transforms.append(one)
            is_new |= name not in self._static
            self._static[name] = one
        if transforms:
            yield Output(topics.TF, "", Transforms(tuple(transforms)))
        if transforms and (is_new or self._is_static_due or not self._poses):
            self._is_static_due = False
            yield Output(topics.TF_STATIC, "", Transforms(tuple(self._static.values())))

    def _say_floor(self) -> Iterator[Output]:
        if not self._floors:
            return
        name = next(iter(self._floors))
        camera = self._floors.pop(name)
        self._floor_from[name] = camera.map_from_camera
        points = coverage(camera.map_from_camera, camera.lens, self._target)
        if len(points):
            yield Output(topics.COVERAGE, name, Polygon(self._taken_ns or 0, "map", points))


def _has_passed(last_ns: int | None, stamp_ns: int, period_ns: int) -> bool:
    return last_ns is None or not 0 <= stamp_ns - last_ns < period_ns
