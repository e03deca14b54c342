"""What an explanation is scored on: a small pose graph over what each visit says.

Unknowns are the robots' poses at the beginnings of visits, the places of the cameras, and lenses,
clocks and odometry scales where they are estimated. A visit's mode ties one robot pose to one place
(`local`); odometry ties the robot poses, but where a lift breaks it. The score is -2 ln of the
posterior with all of these integrated out (Laplace's approximation at the minimum, `minimum`), so
explanations of different dimension compare rightly.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trigpoint.clock import to_ns
from trigpoint.fusion.model.assembly import lens_sigmas
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.odometry import PLANAR, SPATIAL
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from .equations import Factor
from .events import Events
from .linear import HELD
from .mode import Mode
from .modes import VisitModes, odometry_poses

_SCALE_STEP = 0.01
_CLOCK_SIGMAS = 5.0
Place = tuple[str, int]
"""A camera and which of its places, counted from 0 in the order in which it hung there."""
Break = tuple[str, int]
"""A robot and the node after which it was lifted."""


@dataclass(frozen=True, slots=True)
class Tie:
    """A visit that is used: which of its modes, at which place of its camera."""

    mode: int
    place: int


@dataclass(frozen=True, slots=True)
class Layout:
    """Where the unknowns of a graph stand: rows of each robot's nodes (n, d) and scales (2,), of
    places (6,), and of the cameras' own unknowns."""

    size: int
    nodes: dict[str, np.ndarray]
    scales: dict[str, np.ndarray]
    places: dict[Place, np.ndarray]
    own: dict[str, np.ndarray]


@dataclass(frozen=True, slots=True)
class Placed:
    """A graph at its minimum: `score`; `nodes`: by robot its poses at its visits; `places`: where
    cameras are; `factor`: of the information, rows as in `layout`."""

    score: float
    nodes: dict[str, Pose]
    places: dict[Place, Pose]
    layout: Layout
    factor: Factor

    def covariance(self, rows: np.ndarray) -> Array:
        """(k, k) of these unknowns."""
        return self.factor.covariance(rows)


@dataclass(frozen=True, slots=True)
class Variant:
    """Something to place: visits' ties and breaks; `near`: what it is like, to start from."""

    ties: Mapping[int, Tie]
    breaks: frozenset[Break]
    near: Placed | None = None


@dataclass(frozen=True, slots=True)
class Steps:
    """Motions (m) between a robot's nodes near scale errors `about` (2,), and their derivatives by
    those (m, 6, 2)."""

    motion: Pose
    by_scale: Array
    about: Array


@dataclass(frozen=True, slots=True)
class Across:
    """A robot's motion across a gap in which its odometry broke, as a visit has it that saw it
    before and after, and the covariance (d, d) of what odometry says beside the gap. `surprise`:
    what the visit's own score has for that motion, taken to be odometry's, which it is not then.
    """

    motion: Pose
    covariance: Array
    surprise: float


class RobotPath:
    """One robot's nodes, a moment each: odometry's poses (n), the information of the motions
    between them in their free directions (m, d, d), and ln |covariance| (m,)."""

    def __init__(self, data: DataSet, robot: str, moments: list[int]) -> None:
        self.track = track = data.tracks[robot]
        self.is_anchored = robot == data.anchored_robot
        first = [track.first_ns] if self.is_anchored else []
        self.stamps_ns = np.unique([*first, *moments]).astype(np.int64)
        self.tangent = PLANAR if track.planar else SPATIAL
        noise = data.site.robots[robot].odometry
        self.scale_sigma = np.array([noise.distance_scale, noise.heading_scale])
        self.odometry = odometry_poses(data, robot, self.stamps_ns)
        self._steps: dict[tuple[int, ...], Steps] = {}
        d = len(self.tangent)
        covariance = np.zeros((0, d, d))
        if len(self.stamps_ns) > 1:
            whole = track.motion(self.stamps_ns, np.zeros(2)).covariance
            covariance = whole[:, self.tangent][:, :, self.tangent] + HELD**2 * np.eye(d)
        self.information = np.linalg.inv(covariance)
        self.log_covariance = np.linalg.slogdet(covariance)[1]

    def steps(self, scales: Array) -> Steps:
        """The motions near scale errors (2,): to first order, from so near that what is left of
        the second is less than noise."""
        cell = tuple(np.round(scales / _SCALE_STEP).astype(int).tolist())
        if cell not in self._steps:
            about = _SCALE_STEP * np.array(cell, dtype=float)
            motion = self.track.motion(self.stamps_ns, about)
            self._steps[cell] = Steps(motion.earlier_from_later, motion.by_scale, about)
        return self._steps[cell]


class Graph:
    """Places explanations of one session's visits."""

    def __init__(self, data: DataSet, visits: list[VisitModes], events: Events) -> None:
        self.data, self.visits, self.events = data, visits, events
        self.paths = {
            robot: RobotPath(
                data, robot, [_moment(data, v) for v in visits if v.visit.robot == robot]
            )
            for robot in data.site.robots
            if any(v.visit.robot == robot for v in visits)
        }
        self.node_of = [
            int(np.searchsorted(self.paths[v.visit.robot].stamps_ns, _moment(data, v)))
            for v in visits
        ]
        self._begin_at: dict[tuple[str, int], list[int]] = {}
        for number, (found, node) in enumerate(zip(visits, self.node_of, strict=True)):
            self._begin_at.setdefault((found.visit.robot, node), []).append(number)
        self._known_covariance = np.linalg.inv(data.known.information)
        self._across: dict[Break, Across | None] = {}
        self._clocks = [_clock(data, v) for v in visits]
        self._relative = [self._seen_from(number, v.modes) for number, v in enumerate(visits)]
        self._own_values = [
            np.array([own_values(data, v.visit.camera, mode) for mode in v.modes]) for v in visits
        ]
        self._covariance = [np.linalg.inv(one)[:, :6, :6] for _, one in self._relative]
        self.own_prior = {
            camera: prior
            for camera in dict.fromkeys(v.visit.camera for v in visits)
            if len((prior := own_prior(data, camera))[0])
        }

    def _seen_from(self, number: int, modes: Sequence[Mode]) -> tuple[Pose, Array]:
        """A visit's modes (k) from the robot's pose at its beginning: base_from_camera, and the
        information (k, q, q) in those axes."""
        robot = self.visits[number].visit.robot
        start = self.paths[robot].odometry[self.node_of[number]]
        if not modes:
            return Pose.stack([]), np.zeros((0, 6, 6))
        information = np.array([mode.information for mode in modes])
        turn = np.eye(information.shape[-1])
        turn[:3, :3] = turn[3:6, 3:6] = start.rotation.T
        seen = start.inverse() @ Pose.stack([mode.map_from_camera for mode in modes])
        return seen, turn @ information @ turn.T

    def relative(self, number: int) -> tuple[Pose, Array]:
        """base_from_camera (k) of a visit's modes, and their information (k, q, q)."""
        return self._relative[number]

    def own_values(self, number: int) -> Array:
        """What a visit's modes say of its camera's own unknowns, (k, o)."""
        return self._own_values[number]

    def spread(self, number: int) -> Array:
        """The covariance (k, 6, 6) of where a visit's modes put the camera, in the robot's axes."""
        return self._covariance[number]

    def known_information(self, order: int) -> Array:
        """(6, 6) of a camera known from before, by itself."""
        part = slice(6 * order, 6 * order + 6)
        return np.linalg.inv(self._known_covariance[part, part])

    def room(self, path: RobotPath) -> Array:
        """Variances (d,) of where a robot may be put down."""
        return self.events.room_variances[path.tangent]

    def across(self, gap: Break) -> Across | None:
        """The motion across a gap by the visit that tells most of it; None where no visit goes on
        from before it to after it."""
        if gap not in self._across:
            numbers = range(len(self.visits))
            each = [one for n in numbers if (one := self._told_across(gap, n)) is not None]
            tight = min(each, key=lambda one: np.linalg.slogdet(one.covariance)[1], default=None)
            self._across[gap] = tight
        return self._across[gap]

    def _told_across(self, gap: Break, number: int) -> Across | None:
        robot, step = gap
        path, found = self.paths[robot], self.visits[number]
        begin, end = path.stamps_ns[step : step + 2].tolist()
        stamps = [stamp_ns for stamp_ns, _ in found.right]
        goes_on = bool(stamps) and min(stamps) <= begin and max(stamps) >= end
        if found.visit.robot != robot or not found.modes or not goes_on:
            return None
        first, last = (self._begin_at.get((robot, node), []) for node in (step, step + 1))
        before = [
            one
            for one in found.right
            if one[0] <= begin and all(self._precedes(number, one[0], n, begin) for n in first)
        ]
        after = [
            one
            for one in found.right
            if one[0] >= end and all(self._precedes(n, end, number, one[0]) for n in last)
        ]
        if not before or not after:
            return None
        (until_ns, earlier), (since_ns, later) = before[-1], after[0]
        moments = np.clip([until_ns, since_ns], path.track.first_ns, path.track.last_ns)
        odometry = odometry_poses(self.data, robot, moments)
        poses = found.modes[0].poses
        seen = poses[earlier].inverse() @ poses[later]
        error = seen.difference(odometry[0].inverse() @ odometry[1])[path.tangent]
        motion = path.odometry[step].inverse() @ odometry[0] @ seen
        motion = motion @ odometry[1].inverse() @ path.odometry[step + 1]
        (whole,) = path.track.motion(moments, np.zeros(2)).covariance
        covariance = whole[np.ix_(path.tangent, path.tangent)] + HELD**2 * np.eye(len(path.tangent))
        return Across(motion, covariance, float(error @ np.linalg.solve(covariance, error)))

    def _precedes(self, first: int, first_ns: int, second: int, second_ns: int) -> bool:
        """Whether what one visit's camera stamped is surely not after what another's did."""
        if self.visits[first].visit.camera == self.visits[second].visit.camera:
            return first_ns <= second_ns
        (offset, sigma), (other_offset, other_sigma) = self._clocks[first], self._clocks[second]
        apart_ns = (second_ns - other_offset) - (first_ns - offset)
        return apart_ns >= _CLOCK_SIGMAS * float(np.hypot(sigma, other_sigma))

    def layout(self, places: Sequence[Place]) -> Layout:
        """With all robots' nodes and these places."""
        size = 0

        def rows(count: int) -> np.ndarray:
            nonlocal size
            size += count
            return np.arange(size - count, size)

        nodes, scales = {}, {}
        for robot, path in self.paths.items():
            d = len(path.tangent)
            nodes[robot] = rows(len(path.stamps_ns) * d).reshape(-1, d)
            if np.any(path.scale_sigma > 0):
                scales[robot] = rows(2)
        at = {place: rows(6) for place in places}
        cameras = dict.fromkeys(camera for camera, _ in places)
        own = {c: rows(len(self.own_prior[c][0])) for c in cameras if c in self.own_prior}
        return Layout(size, nodes, scales, at, own)


def _clock(data: DataSet, found: VisitModes) -> tuple[float, float]:
    """A camera's time offset by a visit, and its sigma, ns."""
    sigma_s = data.site.cameras[found.visit.camera].time_offset_sigma
    if sigma_s == 0 or not found.modes:
        return 0.0, to_ns(sigma_s)
    mode = found.modes[0]
    # Of a mode's unknowns the last are the time's offset and drift.
    variance = float(np.linalg.inv(mode.information)[-2, -2])
    return to_ns(mode.camera.time_offset_s), to_ns(min(np.sqrt(variance), sigma_s))


def own_prior(data: DataSet, camera: str) -> tuple[Array, Array]:
    """A camera's own unknowns beside its pose, lens and clock: their prior means and sigmas."""
    config, lens = data.site.cameras[camera], data.lenses[camera]
    mean, sigma = np.zeros(0), np.zeros(0)
    if config.estimates_intrinsics:
        mean, sigma = lens.parameters, lens_sigmas(config, lens)
    if config.time_offset_sigma > 0:
        mean = np.concatenate([mean, np.zeros(2)])
        drift = max(config.time_drift_sigma, HELD)
        sigma = np.concatenate([sigma, [config.time_offset_sigma, drift]])
    return mean, np.where(sigma > 0, sigma, HELD)


def own_values(data: DataSet, camera: str, mode: Mode) -> Array:
    """The same by a mode."""
    config = data.site.cameras[camera]
    values = mode.camera.lens.parameters if config.estimates_intrinsics else np.zeros(0)
    if config.time_offset_sigma > 0:
        values = np.concatenate([values, [mode.camera.time_offset_s, mode.camera.time_drift]])
    return values


def _moment(data: DataSet, modes: VisitModes) -> int:
    track = data.tracks[modes.visit.robot]
    return int(np.clip(modes.visit.stamp_ns, track.first_ns, track.last_ns))
