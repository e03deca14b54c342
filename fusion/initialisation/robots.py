"""Initialisation of a robot in the map, by what located cameras see of it.

One picture of a face that others look like allows several poses, and so does a robot that turns on
the spot. So every pose that single pictures of a visit to a camera allow is refined over the visit
and its odometry, and over the visits that follow, until only one is left that fits.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from trigpoint.clock import to_ns
from trigpoint.fusion.model.assembly import assemble
from trigpoint.fusion.model.dataset import DataSet, Entry, KnownCameras
from trigpoint.fusion.model.gates import DECISIVE, HUBER_SIGMAS
from trigpoint.fusion.model.observations import Reading, Verdict
from trigpoint.fusion.model.odometry import composed
from trigpoint.fusion.model.prediction import batch_jacobian
from trigpoint.fusion.model.problem import Problem, State
from trigpoint.fusion.reading import faces
from trigpoint.fusion.reading.alignment import placements
from trigpoint.fusion.reading.coarse_fit import WORST_PX
from trigpoint.fusion.solver.filter import Filter
from trigpoint.fusion.solver.levenberg_marquardt import solve
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from .camera_hypotheses import ACCEPTABLE_RMS, MOST_HYPOTHESES
from .start_poses import spread

# A robot that was out of sight for longer comes for another visit.
_AWAY_NS = to_ns(2.0)
_MOST_SEEDS = 6
_MOST_SCORED = 6
# As in `start_poses`: a start whose mean-square error, pixels², is this much above the best is
# none.
_FAR_PX2 = 100.0
_MOST_PICTURES = 24
_LEAST_PICTURES = 4
_MOST_STARTS = 3
_MOST_ROUNDS = 3
_MOST_ITERATIONS = 15
# A pose this much worse (χ²) than the best one is excluded, whatever follows.
_HOPELESS = 100.0
# Of the corners, how many must fit: a whole visit of several that does not must not be outvoted.
_SHARE = 0.75
# 0.1 mm and 0.1 mrad: keeps the cameras' information finite.
_FLOOR = 1e-8


@dataclass(frozen=True, slots=True)
class RobotLocation:
    """One possible location of a robot in the map: its poses at observations, and their readings;
    `cost`: χ² with the odometry's; `rms`: of a coordinate, sigmas."""

    map_from_base: dict[int, Pose]
    readings: dict[int, tuple[Reading, ...]]
    cost: float
    rms: float

    def lead(self, other: "RobotLocation") -> float:
        """χ² by which the other one is worse, in units of what this one leaves over."""
        return (other.cost - self.cost) / max(1.0, self.rms**2)

    def is_like(self, other: "RobotLocation") -> bool:
        """Whether it is the same place."""
        index = next(iter(self.map_from_base))
        there = other.map_from_base.get(index)
        return there is not None and faces.is_same_pose(self.map_from_base[index], there)


@dataclass(frozen=True, slots=True)
class RobotUndetermined:
    """Why a robot could not be located in the map, as text."""

    reason: str


def locate_robot(
    data: DataSet, known: Filter, robot: str, indices: list[int]
) -> RobotLocation | RobotUndetermined:
    """Locate a robot in the map by those of these entries of the data set that are of located
    cameras."""
    seen = [i for i in indices if known.has_camera(data.entries[i].observation.camera)]
    if not seen:
        return RobotUndetermined("it has met no located camera yet; drive it past one")
    search = _Search(data, known, robot, seen)
    result = None
    for first in range(min(len(search.visits), _MOST_STARTS)):
        found = search.since(first)
        if isinstance(found, RobotLocation):
            return found
        result = result or found
    assert result is not None  # there is a visit where something was seen
    return result


class _Search:
    """One `locate_robot`. `visits`: the entries of each visit to a camera, in order of time."""

    def __init__(self, data: DataSet, known: Filter, robot: str, seen: list[int]) -> None:
        self.data, self.known, self.robot = data, known, robot
        track = data.tracks[robot]
        seen = sorted(seen, key=self._stamp_ns)
        stamps = np.array([self._stamp_ns(index) for index in seen], dtype=np.int64)
        self.visits = self._visits(seen)
        moments, rows = np.unique(
            np.clip(stamps, track.first_ns, track.last_ns), return_inverse=True
        )
        self.rows = dict(zip(seen, rows.tolist(), strict=True))
        self.path = Pose.stack([Pose.identity()])
        if len(moments) > 1:
            steps = track.motion(moments, known.scales(robot)).earlier_from_later
            self.path = composed(steps)

    def _visits(self, seen: list[int]) -> list[list[int]]:
        """Runs of entries of one camera each, the earliest first: a camera that was moved must not
        spoil the evidence of the others."""
        visits: list[list[int]] = []
        last: dict[str, list[int]] = {}
        for index in seen:
            camera = self.data.entries[index].observation.camera
            visit = last.get(camera)
            if visit is None or self._stamp_ns(index) - self._stamp_ns(visit[-1]) > _AWAY_NS:
                visit = last[camera] = []
                visits.append(visit)
            visit.append(index)
        return visits

    def _stamp_ns(self, index: int) -> int:
        return self.data.entries[index].observation.stamp_ns

    def since(self, first: int) -> RobotLocation | RobotUndetermined:
        """Locate the robot by its visits from this one on."""
        window = [self.visits[first]]
        alive = _distinct(
            self._refined(start, self._chosen(window)) for start in self._starts(self.visits[first])
        )
        for visit in self.visits[first + 1 :]:
            if not self._is_open(alive):
                break
            window.append(visit)
            chosen = self._chosen(window)
            alive = _distinct(self._refined(start.map_from_base, chosen) for start in alive)
        return self._decided(alive)

    def _is_open(self, alive: list[RobotLocation]) -> bool:
        """Whether more is needed to decide, and may help."""
        return len(alive) > 1 and alive[0].rms <= ACCEPTABLE_RMS

    def _decided(self, alive: list[RobotLocation]) -> RobotLocation | RobotUndetermined:
        if not alive or alive[0].rms > ACCEPTABLE_RMS:
            return RobotUndetermined(
                "what located cameras saw of it contradicts them or its odometry"
            )
        if len(alive) > 1 and alive[0].lead(alive[1]) < DECISIVE:
            return RobotUndetermined(
                f"{len(alive)} places fit alike, since its faces look alike; drive it past a "
                "located camera"
            )
        return alive[0]

    def _chosen(self, window: list[list[int]]) -> list[int]:
        """Some of the entries of every visit."""
        most = max(_LEAST_PICTURES, _MOST_PICTURES // len(window))
        return [index for visit in window for index in spread(visit, most)]

    def _starts(self, visit: list[int]) -> list[dict[int, Pose]]:
        """The robot's possible poses at one of the visit's pictures."""
        starts: list[tuple[int, Pose]] = []
        for index in spread(visit, _MOST_SEEDS):
            observation = self.data.entries[index].observation
            camera = self.known.state.cameras[observation.camera]
            starts += [
                (index, pose)
                for pose in placements(
                    observation,
                    self.data.targets[self.robot],
                    camera.lens,
                    camera.map_from_camera,
                    tangent=self.data.tracks[self.robot].tangent,
                )
            ]
        if not starts:
            return []
        here = Pose.stack([self._carried({index: pose}, visit[0]) for index, pose in starts])
        costs = self._mean_cost(visit[0], here, spread(visit, _MOST_SCORED))
        order = [i for i in np.argsort(costs, kind="stable") if costs[i] < costs.min() + _FAR_PX2]
        kept: list[int] = []
        for i in order:
            if len(kept) < MOST_HYPOTHESES and not np.any(
                faces.are_same_pose(here[np.array(kept, dtype=int)], here[i])
            ):
                kept.append(int(i))
        return [dict(starts[i : i + 1]) for i in kept]

    def _mean_cost(self, first: int, here: Pose, chosen: list[int]) -> Array:
        """How badly the pictures fit where the robot stands at the first of them (n): the mean over
        their views of the least mean-square error, pixels², each capped, (n,)."""
        total, views = np.zeros(len(here)), 0
        for index in chosen:
            observation = self.data.entries[index].observation
            camera = self.known.state.cameras[observation.camera]
            between = self.path[self.rows[first]].inverse() @ self.path[self.rows[index]]
            camera_from_base = camera.map_from_camera.inverse() @ here @ between
            for view in observation.views:
                rms = faces.readings_rms_px(
                    view, self.data.targets[self.robot], camera.lens, camera_from_base
                )
                total += np.minimum(rms.min(axis=1), WORST_PX) ** 2
                views += 1
        return total / max(views, 1)

    def _carried(self, where: dict[int, Pose], index: int) -> Pose:
        """The robot's pose at an entry, by odometry from the nearest known pose."""
        if index in where:
            return where[index]
        stamp_ns = self._stamp_ns(index)
        nearest = min(where, key=lambda other: abs(self._stamp_ns(other) - stamp_ns))
        between = self.path[self.rows[nearest]].inverse() @ self.path[self.rows[index]]
        return where[nearest] @ between

    def _refined(self, where: dict[int, Pose], chosen: list[int]) -> RobotLocation | None:
        """The best solution near a start; each picture is read as it fits best, again whenever the
        solution has moved; None where nothing fits."""
        poses = {index: self._carried(where, index) for index in chosen}
        before, found = None, None
        for _ in range(_MOST_ROUNDS):
            readings = self._readings(poses)
            if not readings or readings == before:
                break
            found = self._solved(readings, poses)
            if found is None:
                break
            before, poses = readings, poses | found.map_from_base
        return found

    def _readings(self, poses: dict[int, Pose]) -> dict[int, tuple[Reading, ...]]:
        """The best reading of each picture; those that fit in no way are left out."""
        found = {}
        for index, map_from_base in poses.items():
            observation = self.data.entries[index].observation
            camera = self.known.state.cameras[observation.camera]
            camera_from_base = camera.map_from_camera.inverse() @ map_from_base
            target = self.data.targets[self.robot]
            best = [
                faces.best_reading(view, target, camera.lens, camera_from_base)
                for view in observation.views
            ]
            if all(np.isfinite(rms) for _, rms, _ in best):
                found[index] = tuple(reading for reading, _, _ in best)
        return found

    def _solved(
        self, readings: dict[int, tuple[Reading, ...]], poses: dict[int, Pose]
    ) -> RobotLocation | None:
        order = list(readings)
        entries = [
            Entry(
                self.data.entries[i].observation.read_as(readings[i]).judged(Verdict.ACCEPTED),
                poses[i],
            )
            for i in order
        ]
        cameras = {entry.observation.camera for entry in entries}
        small = replace(self.data, entries=entries, known=self._known(sorted(cameras)))
        state = State(
            {name: self.known.state.cameras[name] for name in cameras}, self.known.state.robots
        )
        assembled = assemble(small, state, list(range(len(entries))), fill=False)
        solution = solve(
            assembled.problem,
            assembled.start,
            huber=HUBER_SIGMAS,
            tolerance=1e-3,
            most_iterations=_MOST_ITERATIONS,
        )
        if not np.isfinite(solution.cost):
            return None
        nodes = solution.state.robots[self.robot].map_from_base
        where = {order[i]: nodes[node] for i, node in assembled.node_of.items()}
        # Observations that fit in no way cost as much as a picture full of outliers would.
        missing = HUBER_SIGMAS**2 * sum(
            self.data.entries[i].observation.corner_count for i in poses.keys() - where
        )
        rms = _rms(assembled.problem, solution.state)
        rms = rms if len(where) >= _SHARE * len(poses) else np.inf
        return RobotLocation(where, readings, solution.cost + missing, rms)

    def _known(self, cameras: list[str]) -> KnownCameras:
        """These cameras as they are known by now."""
        every = np.arange(self.known.layout.size)
        columns = np.concatenate([every[self.known.layout.pose[name]] for name in cameras])
        covariance = self.known.known.covariance_of(columns)
        poses = {name: self.known.state.cameras[name].map_from_camera for name in cameras}
        return KnownCameras(poses, np.linalg.inv(covariance + _FLOOR * np.eye(len(columns))))


def _distinct(found: Iterable[RobotLocation | None]) -> list[RobotLocation]:
    """The different ones that the best does not rule out, best first."""
    kept: list[RobotLocation] = []
    for one in sorted((one for one in found if one is not None), key=lambda one: one.cost):
        if kept and kept[0].lead(one) > _HOPELESS:
            break
        if not any(one.is_like(other) for other in kept):
            kept.append(one)
    return kept


def _rms(problem: Problem, state: State) -> float:
    """RMS of a coordinate over the best corners, in sigmas: from a quantile q of their lengths,
    which for normal coordinates is √(-2 ln(1 - q))."""
    lengths: list[Array] = []
    for batch in problem.batches:
        _, residual, _ = batch_jacobian(problem, batch, state)
        lengths.append(np.linalg.norm(residual, axis=-1)[batch.weights > 0])
    found = float(np.quantile(np.concatenate(lengths), _SHARE))
    return found / float(np.sqrt(-2 * np.log(1 - _SHARE)))
