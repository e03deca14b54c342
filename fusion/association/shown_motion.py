"""How a robot moved by the pictures alone, and how well odometry fits that.

A board in one picture tells the robot's pose by the camera, roughly; two pictures of one visit tell
how the robot moved between them in its own axes, whatever the camera's pose is.
"""

from collections.abc import Sequence

import numpy as np
from msgspec import Struct

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.observations import Observation, face_points
from trigpoint.fusion.model.odometry import OdometryTrack
from trigpoint.fusion.model.trajectory import odometry_poses
from trigpoint.geometry import Pose
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.samples import median

from .sightings import planar_poses
from .visits import Visit


class ShownMotion(Struct, frozen=True):
    """Motions (n) of one robot between two moments each, `times_ns` (2, n), and `shown`: for each
    of them earlier_from_later by each way (m) to read its two pictures."""

    times_ns: np.ndarray
    shown: tuple[Pose, ...]

    def misfit(self, track: OdometryTrack) -> float:
        """The median distance of what is shown from what odometry tells, a radian as a metre."""
        return median([float(np.min(_apart(*each))) for each in self._pairs(track)])

    def longer(self, track: OdometryTrack) -> float:
        """How many times as long as shown odometry tells ways: the median over the long ones. Of
        the ways to read two pictures, the one whose turn is likest counts: lengths tell nothing."""
        pairs = list(self._pairs(track))
        told = np.array([np.linalg.norm(each.translation) for each, _ in pairs])
        shown = [np.linalg.norm(s.translation[np.argmin(_turned(t, s))]) for t, s in pairs]
        is_long = (told > 0) & (told >= told.max() / 2)
        return median(told[is_long] / np.array(shown)[is_long]) if np.any(is_long) else 1.0

    def _pairs(self, track: OdometryTrack) -> "zip[tuple[Pose, Pose]]":
        """Each motion as told, earlier_from_later, and as shown."""
        earlier, later = (odometry_poses(track, times) for times in self.times_ns)
        told = earlier.inverse() @ later
        return zip((told[i] for i in range(len(told))), self.shown, strict=True)


def shown_motion(
    data: DataSet, observations: Sequence[Observation], visits: Sequence[Visit]
) -> ShownMotion | None:
    """The motion of one robot in visits, each between its pictures that are half of the visit
    apart; None where no two tell any."""
    times, shown = list[tuple[int, int]](), list[Pose]()
    for visit in visits:
        seen = [observations[index] for index in visit.chosen]
        track = data.tracks[visit.robot]
        found = [
            (each.stamp_ns, _poses(data, each)) for each in seen if track.covers(each.stamp_ns)
        ]
        half = len(found) // 2
        for (first_ns, first), (last_ns, last) in zip(found[:half], found[-half:], strict=False):
            if half and len(first) and len(last):
                times.append((first_ns, last_ns))
                shown.append(_each_by_each(first.inverse(), last))
    return ShownMotion(np.array(times).T, tuple(shown)) if times else None


def _poses(data: DataSet, seen: Observation) -> Pose:
    """camera_from_base by the view with the most corners, by each way to read that (at most n)."""
    view = max(seen.views, key=lambda each: len(each.corners))
    found = list[Pose]()
    for reading in view.readings:
        face = data.targets[seen.robot].faces[reading.face]
        points = face_points(face, view.corners, is_turned=reading.is_turned)
        fits = planar_poses(data.lenses[seen.camera], points, view.pixels, view.sigma)
        found += [fit.pose @ face.base_from_face.inverse() for fit in fits[:1]]
    return Pose.stack(found)


def _each_by_each(first: Pose, second: Pose) -> Pose:
    """The products (n · m) of each of n poses with each of m."""
    rows, columns = np.divmod(np.arange(len(first) * len(second)), len(second))
    return first[rows] @ second[columns]


def _turned(told: Pose, shown: Pose) -> Array:
    """The angles (m,) between one rotation and many."""
    return np.linalg.norm(so3.log(told.rotation.T @ shown.rotation), axis=1)


def _apart(told: Pose, shown: Pose) -> Array:
    """The distances (m,) of one motion from many, a radian as a metre."""
    return np.linalg.norm(shown.translation - told.translation, axis=1) + _turned(told, shown)
