"""An immutable copy of a solution's state and information, for guidance to work on."""

import numpy as np
from msgspec import Struct
from msgspec.structs import astuple
from numpy.linalg import LinAlgError

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.odometry import PLANAR, SPATIAL
from trigpoint.fusion.model.problem import Layout, Problem, State
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.samples import median
from trigpoint.site.config import OdometryNoise
from trigpoint.site.target import Target

from .filter import Filter


class ExpectedMotion(Struct, frozen=True):
    """Motions (…) in the free disturbances (d) of the robot: derivatives of the end's by those of
    the start (…, d, d) and by the scale errors of distance and heading (…, d, 2), and the
    covariance (…, d, d) that the motion adds."""

    by_start: Array
    by_scale: Array
    covariance: Array

    def __getitem__(self, index: int | np.ndarray) -> "ExpectedMotion":
        return ExpectedMotion(self.by_start[index], self.by_scale[index], self.covariance[index])


class RobotPlace(Struct, frozen=True):
    """A robot's current pose by its odometry, with its noise and its target.

    `since`: the motion since the filter's last pose of it.
    """

    robot: str
    stamp_ns: int
    map_from_base: Pose
    since: ExpectedMotion
    noise: OdometryNoise
    slip: float
    planar: bool
    target: Target

    @property
    def tangent(self) -> list[int]:
        return PLANAR if self.planar else SPATIAL

    def is_at(self, other: "RobotPlace") -> bool:
        """Whether another is the same place, at whatever time."""
        mine, theirs = (
            (each.map_from_base.rotation, each.map_from_base.translation, *astuple(each.since))
            for each in (self, other)
        )
        is_alike = self.noise == other.noise and self.slip == other.slip
        return is_alike and all(map(np.array_equal, mine, theirs))


def place_of(data: DataSet, known: Filter, robot: str) -> RobotPlace | None:
    """A robot at its last odometry message; None where odometry determines no way to it."""
    track, start_ns = data.tracks[robot], known.stamps_ns[robot]
    pose = known.state.robots[robot].map_from_base[0]
    still = np.eye(len(track.tangent))
    since = ExpectedMotion(still, np.zeros((len(still), 2)), 0.0 * still)
    if start_ns < track.last_ns:
        between = start_ns, track.last_ns, known.scales(robot)
        end, _ = track.carried_on(*between, pose, np.zeros((6, 6)))
        try:
            matrix, _, noise = track.step(*between, pose, end)
        except LinAlgError:
            return None
        since, pose = ExpectedMotion(matrix[:, :-2], matrix[:, -2:], noise), end
    return RobotPlace(
        robot,
        track.last_ns,
        pose,
        since,
        track.noise,
        track.slip,
        track.planar,
        data.targets[robot],
    )


class CameraViews(Struct, frozen=True):
    """Where robots stood when a camera saw them (n, 3), and the usual sigma of a corner, pixels."""

    places: Array
    sigma_px: float


class GuidanceWorld(Struct, frozen=True):
    """What guidance works on. `information`: of the dense part by `layout`; `ways`: each robot's
    solved poses in order; `views`: of the located cameras, each at its last place; `source`: the
    filter and the solution that it is from."""

    layout: Layout
    information: Array
    state: State
    robots: dict[str, RobotPlace]
    ways: dict[str, Pose]
    views: dict[str, CameraViews]
    source: tuple[Filter, Problem, State]

    def is_as(self, other: "GuidanceWorld") -> bool:
        """Whether it is known from nothing else, and each robot stands where it stood."""
        return (
            all(mine is theirs for mine, theirs in zip(self.source, other.source, strict=True))
            and self.robots.keys() == other.robots.keys()
            and all(place.is_at(other.robots[name]) for name, place in self.robots.items())
        )

    @classmethod
    def of(cls, data: DataSet, known: Filter, problem: Problem, state: State) -> "GuidanceWorld":
        """From a solution (`problem`, `state`) and the filter that carries it on."""
        robots = {
            name: place
            for name in data.site.robots
            if known.has_robot(name) and len(data.tracks[name])
            if (place := place_of(data, known, name)) is not None
        }
        ways = {name: state.robots[name].map_from_base for name in problem.chains}
        here = [name for name in data.site.cameras if name in known.layout.pose]
        views = {name: _views(problem, state, name) for name in here}
        information = known.reduced.information
        source = known, problem, state
        return cls(known.layout, information, known.state, robots, ways, views, source)


def _views(problem: Problem, state: State, camera: str) -> CameraViews:
    mine = [batch for batch in problem.batches if batch.camera == camera]
    if not mine:
        return CameraViews(np.zeros((0, 3)), 1.0)
    places = [state.robots[b.robot].map_from_base.translation[b.nodes] for b in mine]
    # 1/sigma of the used corners, their observations' shares taken out.
    weights = [(b.weights / np.sqrt(b.shares)[:, None])[b.weights > 0] for b in mine]
    used = np.concatenate(weights)
    return CameraViews(np.concatenate(places), 1 / median(used) if len(used) else 1.0)
