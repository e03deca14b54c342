"""How a robot moved between the moments at which visits begin: by its odometry or, where a visit
goes on meanwhile, by what that visit shows of the motion.

The pictures of one visit show where the robot stood relative to one camera at rest, and so how it
moved between them, often ten times as precisely as its wheels do. Without that, what two cameras
see at the same time would tell their relative pose no better than odometry does between the two
visits' first pictures.
"""

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.odometry import PLANAR, SPATIAL
from trigpoint.fusion.model.trajectory import odometry_poses
from trigpoint.geometry import Pose
from trigpoint.geometry.chi_square import chi2_limit
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.samples import unique
from trigpoint.geometry.uncertainty import lever, relative_jacobians, turned_axes

from .events import EVIDENCE
from .linear import HELD
from .mode import VisitModes

_SCALE_STEP = 0.01
# The least share, of what a visit shows of a motion, that is not due to odometry: less is nothing.
_LEAST_OWN = 1e-3


class Steps(Struct, frozen=True):
    """Motions (m) between a robot's nodes at scale errors `about` (2,), and their derivatives by
    these (m, 6, 2)."""

    motion: Pose
    by_scale: Array
    about: Array


class RobotPath:
    """One robot's nodes, one for each moment: their poses by odometry (n), the information
    (m, 6, 6) of the motions between them, nil where a direction is not free, and ln |covariance|
    of the free ones (m,)."""

    def __init__(self, data: DataSet, robot: str, moments: list[int]) -> None:
        self.track = track = data.tracks[robot]
        self.is_anchored = robot == data.anchored_robot
        first = [track.first_ns] if self.is_anchored else []
        self.stamps_ns = unique([*first, *moments]).astype(np.int64)
        self.tangent = PLANAR if track.planar else SPATIAL
        noise = data.site.robots[robot].odometry
        self.scale_sigma = np.array([noise.distance_scale, noise.heading_scale])
        self.odometry = odometry_poses(track, self.stamps_ns)
        self._steps: dict[tuple[int, ...], Steps] = {}
        d = len(self.tangent)
        covariance = np.zeros((0, d, d))
        if len(self.stamps_ns) > 1:
            whole = track.motion(self.stamps_ns, np.zeros(2)).covariance
            covariance = whole[:, self.tangent][:, :, self.tangent] + HELD**2 * np.eye(d)
        self.information = in_all_axes(np.linalg.inv(covariance), self.tangent)
        self.log_covariance = np.linalg.slogdet(covariance)[1]

    def steps(self, scales: Array) -> Steps:
        """The motions for scale errors (2,), linearised so near them, at the closest multiples of
        `_SCALE_STEP`, that what the second order leaves is less than noise."""
        cell = tuple(round(scale / _SCALE_STEP) for scale in scales.tolist())
        if cell not in self._steps:
            about = _SCALE_STEP * np.array(cell, dtype=float)
            if len(self.stamps_ns) > 1:
                motion = self.track.motion(self.stamps_ns, about)
                self._steps[cell] = Steps(motion.earlier_from_later, motion.by_scale, about)
            else:  # its first sighting is at its first odometry reading
                nowhere = Pose(np.zeros((0, 3, 3)), np.zeros((0, 3)))
                self._steps[cell] = Steps(nowhere, np.zeros((0, 6, 2)), about)
        return self._steps[cell]


class VisualStep(Struct, frozen=True):
    """A robot's motion between two nodes as visit `number` shows it, with its derivative (6, 2) by
    the odometry's scale errors, its information (6, 6) and ln |covariance|. `surprise`: where
    odometry broke on the way, the part of the visit's own score that is due to that odometry."""

    number: int
    motion: Pose
    by_scale: Array
    information: Array
    log_covariance: float
    surprise: float = 0.0


Picture = tuple[int, int]
"""When it was taken, in ns, and the index of the observation."""


def visual_step(
    path: RobotPath, step: int, number: int, found: VisitModes, pictures: list[Picture]
) -> VisualStep | None:
    """The motion from node `step` to the next as a visit's pictures on the way, in order of time,
    show it. None where odometry is more precise, or contradicts it: if odometry broke, the visit's
    own modes are affected too."""
    if len(pictures) < 2:
        return None
    ends = pictures[0], pictures[-1]
    seen = _moved(path, found, *ends)
    error, noise = _beside_odometry(path, seen, ends)
    if error @ np.linalg.solve(noise, error) > chi2_limit(len(error), EVIDENCE):
        return None
    one = _visual_step(path, step, number, ends, seen)
    return one if one.log_covariance < path.log_covariance[step] else None


def watched_step(
    path: RobotPath, step: int, number: int, found: VisitModes, pictures: tuple[Picture, Picture]
) -> VisualStep | None:
    """The same for a step in which odometry broke, by a picture before it and one after it. The
    visit's modes were solved with that odometry, whose contribution is removed to first order; the
    motion then counts as no better known than by intact odometry. None where nothing is left."""
    free = np.ix_(path.tangent, path.tangent)
    seen = _moved(path, found, *pictures)
    error, noise = _beside_odometry(path, seen, pictures)
    information = np.linalg.inv(noise)
    root = np.linalg.cholesky(seen.covariance[free] + HELD**2 * np.eye(len(path.tangent)))
    own = np.eye(len(root)) - root.T @ information @ root
    if np.linalg.eigvalsh(own)[0] < _LEAST_OWN:
        return None
    alone = root @ np.linalg.inv(own) @ root.T
    more, spread = np.zeros(6), np.zeros((6, 6))
    more[path.tangent], spread[free] = alone @ information @ error, alone + noise
    error = error + more[path.tangent]
    surprise = float(error @ np.linalg.solve(alone + noise, error))
    surprise += float(np.linalg.slogdet(alone + noise)[1])
    seen = replace(seen, pose=seen.pose.disturbed(more), covariance=spread)
    return replace(_visual_step(path, step, number, pictures, seen), surprise=surprise)


def _beside_odometry(
    path: RobotPath, seen: "_Step", pictures: tuple[Picture, Picture]
) -> tuple[Array, Array]:
    """The difference of a motion between two pictures from odometry's (d,), and the covariance
    (d, d) of the latter, scale errors included."""
    driven = _driven(path, pictures[0][0], pictures[1][0])
    by_scale = driven.by_scale[path.tangent] * path.scale_sigma
    noise = driven.covariance[np.ix_(path.tangent, path.tangent)] + by_scale @ by_scale.T
    error = seen.pose.difference(driven.pose)[path.tangent]
    return error, noise + HELD**2 * np.eye(len(error))


def _visual_step(
    path: RobotPath, step: int, number: int, pictures: tuple[Picture, Picture], seen: "_Step"
) -> VisualStep:
    """The motion from node `step` to the next: by odometry to the first picture, as `seen` between
    the two pictures, and by odometry from the last."""
    begin, end = path.stamps_ns[step : step + 2].tolist()
    (first_ns, _), (last_ns, _) = pictures
    after = _chained(seen, _driven(path, last_ns, end))
    driven = _chained(_driven(path, begin, first_ns), after)
    covariance = driven.covariance[np.ix_(path.tangent, path.tangent)]
    covariance = covariance + HELD**2 * np.eye(len(covariance))
    log_covariance = float(np.linalg.slogdet(covariance)[1])
    information = in_all_axes(np.linalg.inv(covariance), path.tangent)
    return VisualStep(number, driven.pose, driven.by_scale, information, log_covariance)


def in_all_axes(information: Array, tangent: list[int]) -> Array:
    """The information (..., 6, 6) of disturbances of which only the directions `tangent` (d) are
    free, from that of these (..., d, d)."""
    free = np.zeros((len(tangent), 6))
    free[range(len(tangent)), tangent] = 1.0
    return free.T @ information @ free


class _Step(Struct, frozen=True):
    """A motion, its covariance (6, 6), and its derivative (6, 2) by scale errors."""

    pose: Pose
    covariance: Array
    by_scale: Array


def _moved(path: RobotPath, found: VisitModes, earlier: Picture, later: Picture) -> _Step:
    """The motion between two pictures that no mode of a visit takes as wrong: that of the best
    mode, its covariance widened by how far the other modes differ."""
    moved = [mode.moved(earlier[1], later[1], path.tangent) for mode in found.modes]
    (motion, covariance), *others = moved
    for other, _ in others:
        apart = other.difference(motion)[path.tangent]
        covariance = covariance + np.outer(apart, apart)
    spread = np.zeros((6, 6))
    spread[np.ix_(path.tangent, path.tangent)] = covariance
    return _Step(motion, spread, np.zeros((6, 2)))


def _driven(path: RobotPath, from_ns: int, to_ns: int) -> _Step:
    """The motion by odometry from one moment to another, also backwards in time."""
    moments = np.clip([from_ns, to_ns], path.track.first_ns, path.track.last_ns)
    if moments[0] == moments[1]:
        return _Step(Pose.identity(), np.zeros((6, 6)), np.zeros((6, 2)))
    motion = path.track.motion(np.sort(moments), np.zeros(2))
    one = _Step(motion.earlier_from_later[0], motion.covariance[0], motion.by_scale[0])
    if moments[0] < moments[1]:
        return one
    by_pose, _ = relative_jacobians(one.pose, Pose.identity())
    covariance = by_pose @ one.covariance @ by_pose.T
    return _Step(one.pose.inverse(), covariance, by_pose @ one.by_scale)


def _chained(first: _Step, second: _Step) -> _Step:
    """The composition of two motions, the second after the first."""
    end = first.pose @ second.pose
    by_first = lever(end.translation - first.pose.translation)
    by_second = turned_axes(first.pose.rotation)
    return _Step(
        end,
        by_first @ first.covariance @ by_first.T + by_second @ second.covariance @ by_second.T,
        by_first @ first.by_scale + by_second @ second.by_scale,
    )
