"""The score of one explanation: a small pose graph over what each visit says.

Unknowns are the robots' poses at the beginnings of visits, the places of the cameras, and lenses,
clocks and odometry scales where they are estimated. A visit's mode ties one robot pose to one place
(`local`); odometry ties the robot poses, but where a lift breaks it. The score is -2 ln of the
posterior with all of these integrated out (Laplace's approximation at the minimum), so explanations
of different dimension compare rightly.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from trigpoint.fusion.assembly import lens_sigmas
from trigpoint.fusion.dataset import DataSet
from trigpoint.fusion.odometry_track import PLANAR, SPATIAL
from trigpoint.geometry import Pose
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.rotation import Array

from .events import Events
from .local import Mode
from .modes import VisitModes, odometry_poses

_MOST_STEPS = 8
_SMALL_STEP = 1e-5
_HELD = 1e-9  # sigma of what is known exactly


@dataclass(frozen=True, slots=True)
class Tie:
    """A visit that is used: which of its modes, at which place of its camera."""

    mode: int
    place: int


@dataclass(frozen=True, slots=True)
class Placed:
    """A graph at its minimum: `score`; `nodes`: by robot its poses at its visits; `places`: where
    cameras are by (camera, place); `covariance` of all, with `node_rows`, `place_rows` its rows."""

    score: float
    nodes: dict[str, Pose]
    places: dict[tuple[str, int], Pose]
    covariance: Array
    node_rows: dict[str, np.ndarray]
    place_rows: dict[tuple[str, int], np.ndarray]

    def place_covariance(self, key: tuple[str, int]) -> Array:
        """(6, 6) of a camera's place."""
        rows = self.place_rows[key]
        return self.covariance[np.ix_(rows, rows)]


@dataclass(frozen=True, slots=True)
class RobotPath:
    """One robot's nodes, a moment each: odometry's poses and the motions between them."""

    stamps_ns: np.ndarray
    odometry: Pose
    motion: Pose
    covariance: Array
    by_scale: Array
    tangent: list[int]
    is_anchored: bool
    scale_sigma: Array


class Graph:
    """Scores explanations of one session's visits."""

    def __init__(self, data: DataSet, visits: list[VisitModes], events: Events) -> None:
        self.data, self.visits, self.events = data, visits, events
        self.paths = {
            robot: _path(data, robot, [v for v in visits if v.visit.robot == robot])
            for robot in data.site.robots
            if any(v.visit.robot == robot for v in visits)
        }
        self.node_of = [
            int(np.searchsorted(self.paths[v.visit.robot].stamps_ns, _moment(data, v)))
            for v in visits
        ]
        x, y, _ = events.room
        self.room = np.array([x**2 / 12, y**2 / 12, np.pi**2 / 3])
        self._relative = [
            [self._seen_from(number, mode) for mode in v.modes] for number, v in enumerate(visits)
        ]

    def _seen_from(self, number: int, mode: Mode) -> tuple[Pose, Array]:
        """A mode from the robot's pose at its visit's beginning: base_from_camera, and the
        information in those axes."""
        robot = self.visits[number].visit.robot
        start = self.paths[robot].odometry[self.node_of[number]]
        back = start.rotation.T
        turn = np.eye(len(mode.information))
        turn[:3, :3] = turn[3:6, 3:6] = back
        return start.inverse() @ mode.map_from_camera, turn @ mode.information @ turn.T

    def relative(self, number: int, mode: int) -> tuple[Pose, Array]:
        """base_from_camera and its information, by a visit's mode."""
        return self._relative[number][mode]

    # -- the minimum ------------------------------------------------------------------------------

    def placed(
        self,
        ties: Mapping[int, Tie],
        breaks: frozenset[tuple[str, int]],
        near: Placed | None = None,
    ) -> Placed | None:
        """The minimum for these ties and breaks (robot, the node before it); None where it is not
        determined."""
        return _Minimum(self, dict(ties), breaks, near).found()


class _Minimum:
    """Gauss-Newton over one graph."""

    def __init__(
        self,
        graph: Graph,
        ties: dict[int, Tie],
        breaks: frozenset[tuple[str, int]],
        near: Placed | None,
    ) -> None:
        self.graph, self.ties, self.breaks = graph, ties, breaks
        data = graph.data
        self.size = 0
        self.node_rows: dict[str, np.ndarray] = {}
        self.scale_rows: dict[str, np.ndarray] = {}
        for robot, path in graph.paths.items():
            d = len(path.tangent)
            self.node_rows[robot] = self._take(len(path.stamps_ns) * d).reshape(-1, d)
            if np.any(path.scale_sigma > 0):
                self.scale_rows[robot] = self._take(2)
        known = {(camera, 0) for camera in data.known.poses}
        self.keys = sorted({(self._camera(n), tie.place) for n, tie in ties.items()} | known)
        self.place_rows = {key: self._take(6) for key in self.keys}
        self.own_rows: dict[str, np.ndarray] = {}
        self.own_prior: dict[str, tuple[Array, Array]] = {}
        for camera in dict.fromkeys(camera for camera, _ in self.keys):
            mean, sigma = own_prior(data, camera)
            if len(mean):
                self.own_rows[camera] = self._take(len(mean))
                self.own_prior[camera] = mean, sigma
        self.nodes = self._start_nodes(near)
        self.places = self._start_places(near)
        self.own = {camera: mean.copy() for camera, (mean, _) in self.own_prior.items()}
        for number, tie in ties.items():
            camera = self._camera(number)
            if camera in self.own:
                self.own[camera] = own_values(data, camera, self._mode(number, tie))
        self.scales = {robot: np.zeros(2) for robot in self.scale_rows}

    def _take(self, count: int) -> np.ndarray:
        self.size += count
        return np.arange(self.size - count, self.size)

    def _camera(self, number: int) -> str:
        return self.graph.visits[number].visit.camera

    def _robot(self, number: int) -> str:
        return self.graph.visits[number].visit.robot

    def _mode(self, number: int, tie: Tie) -> Mode:
        return self.graph.visits[number].modes[tie.mode]

    # -- where it starts --------------------------------------------------------------------------

    def _start_nodes(self, near: Placed | None) -> dict[str, Pose]:
        found = {}
        for robot, path in self.graph.paths.items():
            if near is not None and not any(r == robot for r, _ in self.breaks):
                found[robot] = near.nodes[robot]
            else:
                found[robot] = self._chained(robot, path)
        return found

    def _chained(self, robot: str, path: RobotPath) -> Pose:
        """Along odometry; after a break from where the next tie to a place seen before puts it."""
        places = {(camera, 0): pose for camera, pose in self.graph.data.known.poses.items()}
        poses = [path.odometry[0]]
        loose = not path.is_anchored
        by_node: dict[int, list[int]] = {}
        for number in self.ties:
            if self._robot(number) == robot:
                by_node.setdefault(self.graph.node_of[number], []).append(number)
        since = 0
        for node in range(len(path.stamps_ns)):
            if node:
                poses.append(poses[-1] @ path.motion[node - 1])
                if (robot, node - 1) in self.breaks:
                    loose, since = True, node
            for number in by_node.get(node, []):
                key = self._camera(number), self.ties[number].place
                relative, _ = self.graph.relative(number, self.ties[number].mode)
                if key in places and loose:
                    there = places[key] @ relative.inverse()
                    x, y, _ = there.translation
                    there = Pose.planar(x, y, there.heading)
                    shift = there @ poses[-1].inverse()
                    poses[since:] = [shift @ pose for pose in poses[since:]]
                    loose = False
                if not loose:
                    places.setdefault(key, poses[-1] @ relative)
        return Pose.stack(poses)

    def _start_places(self, near: Placed | None) -> dict[tuple[str, int], Pose]:
        places = {(camera, 0): pose for camera, pose in self.graph.data.known.poses.items()}
        if near is not None:
            places |= {key: pose for key, pose in near.places.items() if key in self.place_rows}
        for number, tie in self.ties.items():
            relative, _ = self.graph.relative(number, tie.mode)
            at = self.nodes[self._robot(number)][self.graph.node_of[number]]
            places.setdefault((self._camera(number), tie.place), at @ relative)
        return places

    # -- steps ------------------------------------------------------------------------------------

    def found(self) -> Placed | None:
        cost, matrix = np.inf, np.zeros((0, 0))
        for _ in range(_MOST_STEPS):
            matrix, gradient, cost = self._equations()
            try:
                factor = cho_factor(matrix, lower=True)
            except (LinAlgError, ValueError):
                return None
            step = -cho_solve(factor, gradient)
            self._move(step)
            if np.abs(step).max() < _SMALL_STEP or -gradient @ step < 1e-4:
                break
        matrix, gradient, cost = self._equations()
        try:
            factor = cho_factor(matrix, lower=True)
        except (LinAlgError, ValueError):
            return None
        covariance = cho_solve(factor, np.eye(self.size))
        determinant = 2 * float(np.sum(np.log(np.diagonal(factor[0]))))
        score = cost + determinant + self._constant()
        if not np.isfinite(score):
            return None
        return Placed(score, self.nodes, self.places, covariance, self.node_rows, self.place_rows)

    def _constant(self) -> float:
        """What does not hang on where things are."""
        score = 0.0
        for robot, path in self.graph.paths.items():
            room = float(np.sum(np.log(self._room(path))))
            free = np.ix_(path.tangent, path.tangent)
            for step in range(len(path.stamps_ns) - 1):
                if (robot, step) in self.breaks:
                    score += room + self.graph.events.lift_score
                else:
                    score += float(np.linalg.slogdet(path.covariance[step][free])[1])
        known = self.graph.data.known.poses
        unknown = [key for key in self.places if key[1] or key[0] not in known]
        score += len(unknown) * self.graph.events.pose_score
        return score + sum(self._mode(number, tie).score for number, tie in self.ties.items())

    def _room(self, path: RobotPath) -> Array:
        if len(path.tangent) == 3:
            return self.graph.room
        height = self.graph.events.room[2] ** 2 / 12
        return np.concatenate([self.graph.room[:2], [height], np.repeat(self.graph.room[2], 3)])

    def _equations(self) -> tuple[Array, Array, float]:
        self._matrix = np.zeros((self.size, self.size))
        self._gradient, self._cost = np.zeros(self.size), 0.0
        for robot, path in self.graph.paths.items():
            self._add_path(robot, path)
        for number, tie in self.ties.items():
            self._add_visit(number, tie)
        for camera, (mean, sigma) in self.own_prior.items():
            rows = self.own_rows[camera]
            error = self.own[camera] - mean
            # Each visit has the prior once; together they have it once.
            visits = sum(self._camera(number) == camera for number in self.ties)
            information = np.diag((1 - visits) / sigma**2)
            self._add(rows, np.eye(len(rows)), error, information)
        self._add_known()
        return self._matrix, self._gradient, self._cost

    def _add(self, rows: np.ndarray, jacobian: Array, residual: Array, information: Array) -> None:
        weighted = jacobian.T @ information
        self._matrix[np.ix_(rows, rows)] += weighted @ jacobian
        self._gradient[rows] += weighted @ residual
        self._cost += float(residual @ information @ residual)

    def _add_path(self, robot: str, path: RobotPath) -> None:
        rows, nodes, tangent = self.node_rows[robot], self.nodes[robot], path.tangent
        free = np.ix_(tangent, tangent)
        first = nodes[0].difference(path.odometry[0])[tangent]
        sigma2 = np.full(len(tangent), _HELD**2) if path.is_anchored else self._room(path)
        self._add(rows[0], np.eye(len(tangent)), first, np.diag(1 / sigma2))
        scales = self.scales.get(robot, np.zeros(2))
        if robot in self.scale_rows:
            held = np.where(path.scale_sigma > 0, path.scale_sigma, _HELD)
            self._add(self.scale_rows[robot], np.eye(2), scales, np.diag(held**-2.0))
        for step in range(len(path.stamps_ns) - 1):
            earlier, later = nodes[step], nodes[step + 1]
            back = earlier.rotation.T
            between = later.translation - earlier.translation
            reported = path.motion[step].disturbed(path.by_scale[step] @ scales)
            residual = np.concatenate(
                [
                    back @ between - reported.translation,
                    so3.log(back @ later.rotation @ reported.rotation.T),
                ]
            )
            by_later = np.zeros((6, 6))
            by_later[:3, :3] = by_later[3:, 3:] = back
            by_earlier = -by_later
            by_earlier[:3, 3:] = back @ so3.hat(between)
            if (robot, step) in self.breaks:
                information = np.diag(1 / self._room(path))
                residual = np.zeros(6)  # anywhere: the width alone keeps it determined
            else:
                information = np.linalg.inv(path.covariance[step][free])
            parts = [by_earlier[free], by_later[free]]
            columns = [rows[step], rows[step + 1]]
            if robot in self.scale_rows and (robot, step) not in self.breaks:
                parts.append(-path.by_scale[step][tangent])
                columns.append(self.scale_rows[robot])
            self._add(np.concatenate(columns), np.hstack(parts), residual[tangent], information)

    def _add_visit(self, number: int, tie: Tie) -> None:
        robot, camera = self._robot(number), self._camera(number)
        path, node = self.graph.paths[robot], self.graph.node_of[number]
        relative, information = self.graph.relative(number, tie.mode)
        base, place = self.nodes[robot][node], self.places[camera, tie.place]
        back = base.rotation.T
        between = place.translation - base.translation
        residual = (base.inverse() @ place).difference(relative)
        by_place = np.zeros((6, 6))
        by_place[:3, :3] = by_place[3:, 3:] = back
        by_base = -by_place
        by_base[:3, 3:] = back @ so3.hat(between)
        columns = [self.node_rows[robot][node], self.place_rows[camera, tie.place]]
        jacobian = np.hstack([by_base[:, path.tangent], by_place])
        if camera in self.own_rows:
            mine = self.own_rows[camera]
            error = self.own[camera] - own_values(self.graph.data, camera, self._mode(number, tie))
            residual = np.concatenate([residual, error])
            whole = np.zeros((len(residual), jacobian.shape[1] + len(mine)))
            whole[:6, : jacobian.shape[1]] = jacobian
            whole[6:, jacobian.shape[1] :] = np.eye(len(mine))
            jacobian = whole
            columns.append(mine)
        self._add(np.concatenate(columns), jacobian, residual, information)

    def _add_known(self) -> None:
        known = self.graph.data.known
        names = list(known.poses)
        if not names:
            return
        joint = np.linalg.inv(known.information)
        for order, name in enumerate(names):
            if (name, 0) in self.place_rows:
                part = slice(6 * order, 6 * order + 6)
                error = self.places[name, 0].difference(known.poses[name])
                information = np.linalg.inv(joint[part, part])
                self._add(self.place_rows[name, 0], np.eye(6), error, information)

    def _move(self, step: Array) -> None:
        for robot, rows in self.node_rows.items():
            whole = np.zeros((len(rows), 6))
            whole[:, self.graph.paths[robot].tangent] = step[rows]
            self.nodes[robot] = self.nodes[robot].disturbed(whole)
        for robot, rows in self.scale_rows.items():
            self.scales[robot] = self.scales[robot] + step[rows]
        for key, rows in self.place_rows.items():
            self.places[key] = self.places[key].disturbed(step[rows])
        for camera, rows in self.own_rows.items():
            self.own[camera] = self.own[camera] + step[rows]


def own_prior(data: DataSet, camera: str) -> tuple[Array, Array]:
    """A camera's own unknowns beside its pose, lens and clock: their prior means and sigmas."""
    config, lens = data.site.cameras[camera], data.lenses[camera]
    mean, sigma = np.zeros(0), np.zeros(0)
    if config.estimates_intrinsics:
        mean, sigma = lens.parameters, lens_sigmas(config, lens)
    if config.time_offset_sigma > 0:
        mean = np.concatenate([mean, np.zeros(2)])
        drift = max(config.time_drift_sigma, _HELD)
        sigma = np.concatenate([sigma, [config.time_offset_sigma, drift]])
    return mean, np.where(sigma > 0, sigma, _HELD)


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


def _path(data: DataSet, robot: str, visits: list[VisitModes]) -> RobotPath:
    track, noise = data.tracks[robot], data.site.robots[robot].odometry
    is_anchored = robot == data.anchored_robot
    moments = [_moment(data, v) for v in visits]
    stamps = np.unique([track.first_ns, *moments] if is_anchored else moments).astype(np.int64)
    tangent = PLANAR if track.planar else SPATIAL
    scale_sigma = np.array([noise.distance_scale, noise.heading_scale])
    odometry = odometry_poses(data, robot, stamps)
    if len(stamps) < 2:
        empty = odometry[:0]
        return RobotPath(
            stamps,
            odometry,
            empty,
            np.zeros((0, 6, 6)),
            np.zeros((0, 6, 2)),
            tangent,
            is_anchored,
            scale_sigma,
        )
    motion = track.motion(stamps, np.zeros(2))
    return RobotPath(
        stamps,
        odometry,
        motion.earlier_from_later,
        motion.covariance,
        motion.by_scale,
        tangent,
        is_anchored,
        scale_sigma,
    )
