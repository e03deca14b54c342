"""Where a robot should go next so that the network's worst camera becomes known best.

A visit is one picture by every camera that would see the target from there. What it is worth is the
expected information: the derivatives of the corners at that pose, at the noise that the camera's
corners have had so far, after the robot has come there by odometry and is as uncertain as that
makes it. Of all candidates (`candidates`) the one is suggested after which the worst
camera, the one with the largest position sigma, is expected to have the smallest.

A suggestion is only where a robot can be expected to be able to drive, near poses that were driven
before, and in sight of a camera only near where that camera has seen a target before: there is no
map of walls. What cameras see on the way there is not counted.

Pure and on immutable inputs, so it may run beside the estimator.
"""

from collections.abc import Iterable

import numpy as np
from msgspec import Struct
from numpy.linalg import LinAlgError

from trigpoint.fusion.model.problem import Layout
from trigpoint.fusion.solver.equations import covariance_of
from trigpoint.fusion.solver.filter import is_placed
from trigpoint.fusion.solver.snapshot import ExpectedMotion, GuidanceWorld, RobotPlace
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import symmetric

from .candidates import Candidates, Ground, candidates, nearest_cameras
from .expected_motion import expected_motion
from .expected_views import Visits, visits

# Beside the worst camera so many others, the nearest ones, are considered: one that is known well
# locates the robot, and with it the camera that saw it last.
_OTHER_CAMERAS = 8
# Two poses within this are one view.
_SAME_PLACE_M, _SAME_HEADING = 0.3, np.radians(20)


class Suggestion(Struct, frozen=True):
    """A pose to visit: `camera` is the worst one, with its position sigma (root of the trace,
    metres) now and as expected after the visit; `seen_by`: the cameras that would see the robot."""

    robot: str
    map_from_base: Pose
    camera: str
    sigma_m: float
    expected_sigma_m: float
    seen_by: tuple[str, ...]

    @property
    def is_worthwhile(self) -> bool:
        """Whether it lowers the sigma by at least 2 %."""
        return self.expected_sigma_m < 0.98 * self.sigma_m


class JointCovariance(Struct, frozen=True):
    """The joint covariance over the dense part, each robot's last pose included."""

    layout: Layout
    covariance: Array

    def sigma_m(self, camera: str) -> float:
        """Root of the trace of a camera's position covariance."""
        rows = self.position_rows(camera)
        return float(np.sqrt(np.trace(self.covariance[np.ix_(rows, rows)])))

    def position_rows(self, camera: str) -> np.ndarray:
        return self.layout.pose[camera][:3]

    def worst(self, cameras: Iterable[str]) -> str | None:
        """The one of these cameras with the largest position sigma; None where none is located."""
        columns = {name: self.layout.pose[name] for name in cameras}
        placed = [n for n, c in columns.items() if is_placed(self.covariance[np.ix_(c, c)])]
        return max(placed, key=self.sigma_m, default=None)

    def columns(self, robot: str) -> tuple[np.ndarray, np.ndarray]:
        """The robot's last pose, and its scales (none where they are not estimated)."""
        return self.layout.last[robot], self.layout.scales_of(robot)

    def moved(self, robot: str, motion: ExpectedMotion) -> "JointCovariance":
        """The covariance after the robot has moved on by odometry."""
        last, scales = self.columns(robot)
        change = np.eye(self.layout.size)
        change[np.ix_(last, last)] = motion.by_start
        change[np.ix_(last, scales)] = motion.by_scale[:, : len(scales)]
        covariance = change @ self.covariance @ change.T
        covariance[np.ix_(last, last)] += motion.covariance
        return JointCovariance(self.layout, covariance)

    def seen(self, columns: np.ndarray, information: Array) -> "JointCovariance":
        """The covariance after a visit at the robot's present pose that tells so much (q, q) of
        these columns (q,)."""
        gain = _gain(information, self.covariance[np.ix_(columns, columns)])
        across = self.covariance[:, columns]
        return JointCovariance(self.layout, self.covariance - across @ gain @ across.T)


def suggestions(world: GuidanceWorld, robot: str, *, count: int = 1) -> list[Suggestion]:
    """The next poses for a robot, each after the one before; fewer where nothing helps.

    Empty where nothing is known yet: no located camera, or a robot that is not located in the map.
    """
    place = world.robots.get(robot)
    if place is None or robot not in world.layout.last:
        return []
    try:
        joint = JointCovariance(world.layout, covariance_of(world.information))
    except LinAlgError:
        return []
    joint = joint.moved(robot, place.since)
    found, ground = [], Ground.of(world)
    here = place.map_from_base
    for _ in range(count):
        best = _best(world, ground, joint, place, here, found)
        if best is None:
            break
        suggestion, joint = best
        found.append(suggestion)
        here = suggestion.map_from_base
    return found


def next_poses(world: GuidanceWorld, *, count: int) -> list[Suggestion]:
    """The next poses of one robot: the one whose first pose helps most."""
    found = [suggestions(world, robot, count=count) for robot in world.robots]
    useful = [poses for poses in found if poses]
    return min(useful, key=lambda poses: poses[0].expected_sigma_m, default=[])


class Options(Struct, frozen=True):
    """Every candidate (n) of one robot with what is expected after it."""

    camera: str
    sigma_m: float
    candidates: Candidates
    motions: ExpectedMotion
    visits: list[Visits]
    expected_sigma_m: Array

    def after(
        self, index: int, robot: str, joint: JointCovariance
    ) -> tuple[Suggestion, JointCovariance]:
        """A candidate, and what is known once the robot was there."""
        (visit,) = [visit for visit in self.visits if index in visit.rows]
        information = visit.information[visit.rows.tolist().index(index)]
        chosen = Suggestion(
            robot,
            self.candidates.map_from_base[index],
            self.camera,
            self.sigma_m,
            float(self.expected_sigma_m[index]),
            visit.cameras,
        )
        return chosen, joint.moved(robot, self.motions[index]).seen(visit.columns, information)


def options(
    world: GuidanceWorld, ground: Ground, joint: JointCovariance, place: RobotPlace, here: Pose
) -> Options | None:
    """What every conceivable visit from `here` is expected to do for the worst camera; None where
    there is none."""
    worst = joint.worst(world.views)
    if worst is None:
        return None
    reach = ground.paths_from(here)
    cameras = [worst, *nearest_cameras(world, ground, reach, without=worst, most=_OTHER_CAMERAS)]
    chosen = candidates(world, ground, reach, place, cameras)
    chosen, found = visits(world, joint.layout, place, chosen, cameras)
    if not found:
        return None
    motions = expected_motion(place, here, chosen.map_from_base, chosen.path_m)
    after = np.zeros(len(chosen.path_m))
    for visit in found:
        after[visit.rows] = _after(joint, place, motions[visit.rows], visit, worst)
    return Options(worst, joint.sigma_m(worst), chosen, motions, found, after)


def _best(
    world: GuidanceWorld,
    ground: Ground,
    joint: JointCovariance,
    place: RobotPlace,
    here: Pose,
    said: Iterable[Suggestion],
) -> tuple[Suggestion, JointCovariance] | None:
    """The best visit to a pose that was not `said`, since a second picture of the same view has the
    first one's systematic errors; and what is known after it."""
    found = options(world, ground, joint, place, here)
    if found is None:
        return None
    expected = found.expected_sigma_m.copy()
    for one in said:
        step = one.map_from_base.inverse() @ found.candidates.map_from_base
        is_near = np.linalg.norm(step.translation, axis=-1) < _SAME_PLACE_M
        ahead = np.hypot(step.rotation[..., 0, 0], step.rotation[..., 1, 0])
        is_alike = step.rotation[..., 0, 0] > np.cos(_SAME_HEADING) * ahead
        expected[is_near & is_alike] = np.inf
    index = int(np.argmin(expected))
    if not np.isfinite(expected[index]):
        return None
    chosen, after = found.after(index, place.robot, joint)
    return (chosen, after) if chosen.is_worthwhile else None


def _after(
    joint: JointCovariance, place: RobotPlace, motions: ExpectedMotion, visit: Visits, camera: str
) -> Array:
    """A camera's position sigma after the robot went somewhere and was seen there, (m,).

    Only what the visit touches is computed, so a candidate costs the same in any network.
    """
    mine = joint.position_rows(camera)
    last, scales = joint.columns(place.robot)
    rows = np.concatenate([visit.columns, mine])
    by_start, by_scale = motions.by_start, motions.by_scale[..., : len(scales)]
    arrived = by_start @ joint.covariance[last] + by_scale @ joint.covariance[scales]
    own = arrived[..., last] @ np.swapaxes(by_start, 1, 2)
    own += arrived[..., scales] @ np.swapaxes(by_scale, 1, 2)
    covariance = np.tile(joint.covariance[np.ix_(rows, rows)], (len(visit.rows), 1, 1))
    d, n = len(last), len(visit.columns)  # the robot's own columns are a visit's first ones
    covariance[:, :d] = arrived[..., rows]
    covariance[..., :d] = np.swapaxes(covariance[:, :d], 1, 2)
    covariance[:, :d, :d] = own + motions.covariance
    across = covariance[:, n:, :n]
    less = across @ _gain(visit.information, covariance[:, :n, :n]) @ np.swapaxes(across, 1, 2)
    return np.sqrt(np.maximum(np.trace(covariance[:, n:, n:] - less, axis1=1, axis2=2), 0.0))


def _gain(information: Array, covariance: Array) -> Array:
    """(P + M⁻¹)⁻¹ (…, q, q) where M may be singular: (I + M P)⁻¹ M."""
    identity = np.eye(covariance.shape[-1])
    return symmetric(np.linalg.solve(identity + information @ covariance, information))
