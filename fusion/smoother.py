"""The default estimator: a smoother over all robot poses and cameras, with a filter for the moment.

Each sighting updates the filter at once; the batch solution is redone when enough has come in since
the last one (so its cost stays a fixed share), and whenever a camera is located.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError

from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from . import judge, repeated
from .assembly import Assembled, true_time_ns
from .consistent import solve_consistently
from .dataset import DataSet, Entry
from .estimator import CameraCount, CameraEstimate, Trajectory, Update
from .faces import PosePrior, align
from .filter import Filter, RobotEstimate, carried_on
from .locate import Located, Undetermined, locate
from .observations import Observation, Verdict
from .odometry_track import Added
from .problem import State
from .solver import Solution
from .survey import camera_estimates, is_placed, joint_covariance
from .trajectory import interpolated

_HUBER = 4.0
_MOST_ROUNDS = 6
_MOST_SETTLING = 3
# What a step may still promise of χ² at the end: 0.3, 0.1 and 0.01 of a sigma.
_ROUGH_TOLERANCE = 0.1
_LIVE_TOLERANCE = 1e-2
_FINAL_TOLERANCE = 1e-4
# An observation's surprise is χ² of twice its corners; beyond this many times that, the sighting,
# the robot or the camera is not where the rest says.
_SURPRISING = 3.0
_FIRST_SOLVE = 20
_SOLVE_SHARE = 0.1
_HISTORY = 64
_LOOSE = (
    "position and orientation in the map: the robot's odometry jumped on its way here from the "
    "other cameras; drive there without a break"
)
_LEAST_PICTURES_LIVE = 3


@dataclass(frozen=True, slots=True)
class _Step:
    """A filter before an observation, so that a late one can be put before it."""

    time_ns: int
    before: Filter
    entry: int


class Smoother:
    """See `Estimator`."""

    def __init__(self, data: DataSet) -> None:
        self.data = data
        self._state = data.first_state()
        self._filter: Filter | None = None
        self._solution: Solution | None = None
        self._assembled: Assembled | None = None
        self._history: deque[_Step] = deque(maxlen=_HISTORY)
        self._since_solve = 0
        self._tries: dict[str, int] = {}
        self._undetermined: dict[str, tuple[str, ...]] = {}
        # Where each robot is by its odometry since the filter's last step, and by which filter;
        # where scales are estimated, the filter carried on that far.
        self._carried: dict[str, tuple[Filter, RobotEstimate, Filter]] = {}
        self._tolerance = _LIVE_TOLERANCE
        self.iterations = 0

    # -- input ------------------------------------------------------------------------------------

    def add_odometry(self, robot: str, stamp_ns: int, odom_from_base: Pose) -> Added:
        added = self.data.tracks[robot].add(stamp_ns, odom_from_base)
        if self._filter is None and (robot == self.data.anchored_robot or self.data.known.poses):
            self._filter = Filter.at_origin(self.data)
        return added

    def add_observation(self, observation: Observation) -> Update:
        before = (self._state, self._filter, self._solution, self._assembled)
        count = len(self.data.entries)
        try:
            return self._add(observation)
        except (LinAlgError, ValueError) as reason:
            # Numbers that no arithmetic survives: the rest goes on as if they had not come.
            del self.data.entries[count:]
            self._state, self._filter, self._solution, self._assembled = before
            self._history.clear()
            return Update(problem=f"a sighting of {observation.camera} is unusable ({reason})")

    def _add(self, observation: Observation) -> Update:
        self.data.entries.append(Entry(observation))
        index = len(self.data.entries) - 1
        if observation.camera in self._state.cameras:
            update = self._use(index)
        else:
            self._guess(index)
            update = self._try_to_locate(observation.camera)
        if self._is_solution_due():
            self.solve()
        return update

    def _is_solution_due(self) -> bool:
        due = max(_FIRST_SOLVE, _SOLVE_SHARE * len(self.data.entries))
        return bool(self._state.cameras) and self._since_solve >= due

    # -- an observation of a located camera -------------------------------------------------------

    def _use(self, index: int) -> Update:
        observation = self.data.entries[index].observation
        if self._filter is None:
            return Update()
        if not self._filter.has_robot(observation.robot):
            return self._tie(index)
        time_ns = true_time_ns(observation, self._state)
        later = self._rewind(observation.robot, time_ns)
        correction = self._apply(index, time_ns)
        for step in later:
            self._apply(step.entry, step.time_ns)
        self._since_solve += 1
        return Update(correction=correction)

    def _rewind(self, robot: str, time_ns: int) -> list[_Step]:
        """Go back before everything of this robot that is later; the steps to do again."""
        assert self._filter is not None
        later: list[_Step] = []
        if self._history and self._history[0].before.stamps_ns.get(robot, 0) > time_ns:
            return later  # older than all of it; the next solution has it
        while self._filter.stamps_ns[robot] > time_ns and self._history:
            step = self._history.pop()
            later.insert(0, step)
            self._filter = step.before
        return later

    def _apply(self, index: int, time_ns: int) -> RobotEstimate | None:
        """Update the filter by an observation; None where it was rejected or came too late."""
        current = self._filter
        assert current is not None
        entry = self.data.entries[index]
        robot = entry.observation.robot
        if time_ns < current.stamps_ns[robot]:
            return None  # older than the history: the next solution has it
        predicted = current.robot(self.data, robot, time_ns)
        aligned = self._aligned(current, entry.observation, predicted)
        if aligned is None:
            entry.observation = entry.observation.judged(Verdict.REJECTED)
            entry.map_from_base = predicted.map_from_base
            return None
        observation, pose = aligned
        moved = current.advanced(self.data, robot, time_ns, pose)
        entry.share = self._share_before(index)
        after, surprise = moved.updated(self.data, observation, share=entry.share)
        entry.map_from_base = pose
        if surprise > _SURPRISING * 2 * observation.corner_count + 50:
            entry.observation = observation.judged(Verdict.REJECTED)
            return None
        entry.observation = observation.judged(Verdict.ACCEPTED)
        self._history.append(_Step(time_ns, current, index))
        self._filter = after
        estimate = after.robot(self.data, robot)
        return estimate if is_placed(estimate.covariance) else None

    def _share_before(self, index: int) -> float:
        """The share of the same camera's last observation, while the robot stands as it did."""
        observation = self.data.entries[index].observation
        for entry in reversed(self.data.entries[max(0, index - 64) : index]):
            other = entry.observation
            if (other.camera, other.robot) == (observation.camera, observation.robot):
                moments = np.array([other.stamp_ns, observation.stamp_ns])
                track = self.data.tracks[observation.robot]
                return entry.share if track.is_still(*np.sort(moments).tolist()) else 1.0
        return 1.0

    def _aligned(
        self, current: Filter, observation: Observation, predicted: RobotEstimate | None
    ) -> tuple[Observation, Pose] | None:
        """The observation as it is read best, and where that puts the robot."""
        camera = current.state.cameras[observation.camera]
        robot = observation.robot
        prior, distance = None, 3.0
        if predicted is not None:
            prior = PosePrior(predicted.map_from_base, predicted.covariance + 1e-10 * np.eye(6))
            between = predicted.map_from_base.translation - camera.map_from_camera.translation
            distance = float(np.linalg.norm(between))
        alignment = align(
            observation,
            self.data.targets[robot],
            camera.lens,
            camera.map_from_camera,
            tangent=self.data.tracks[robot].tangent,
            prior=prior,
            extra_sigma_px=current.camera_sigma_px(observation.camera, distance),
        )
        if alignment is None or alignment.margin < judge.DECISIVE:
            return None
        return observation.read_as(alignment.readings), alignment.map_from_base

    def _tie(self, index: int) -> Update:
        """A robot meets its first located camera: its odometry gets its place in the map."""
        assert self._filter is not None
        entry = self.data.entries[index]
        aligned = self._aligned(self._filter, entry.observation, None)
        if aligned is None:
            return Update()
        observation, entry.map_from_base = aligned
        entry.observation = observation.judged(Verdict.ACCEPTED)
        self.solve()
        return Update()

    # -- an observation of a camera that is not located -------------------------------------------

    def _guess(self, index: int) -> None:
        """Where the robot stood, as far as it is known now."""
        entry = self.data.entries[index]
        observation = entry.observation
        entry.map_from_base = self._pose_at(observation.robot, observation.stamp_ns)

    def _pose_at(self, robot: str, stamp_ns: int) -> Pose | None:
        if self._filter is None or not self._filter.has_robot(robot):
            return None
        if stamp_ns >= self._filter.stamps_ns[robot]:
            return self._filter.robot(self.data, robot, stamp_ns).map_from_base
        if self._assembled is not None and robot in self._assembled.problem.chains:
            chain = self._assembled.problem.chains[robot]
            nodes = self._state.robots[robot].map_from_base
            return interpolated(self.data.tracks[robot], chain, nodes, np.array([stamp_ns]))[0]
        return None

    def _try_to_locate(self, camera: str) -> Update:
        """Try again whenever a camera's pictures have grown by half since the last try."""
        pictures = len(self.data.of_camera(camera))
        if pictures < max(_LEAST_PICTURES_LIVE, 1.5 * self._tries.get(camera, 0)):
            return Update()
        self._tries[camera] = pictures
        if self._locate(camera):
            self.solve()
            return Update(located=(camera,) if camera in self._state.cameras else ())
        return Update()

    def _locate(self, camera: str) -> bool:
        result = locate(self.data, self._state, camera)
        if isinstance(result, Undetermined):
            self._undetermined[camera] = result.reasons
            return False
        self._undetermined.pop(camera, None)
        self._take(camera, result)
        return True

    def _take(self, camera: str, located: Located) -> None:
        self._state = State(self._state.cameras | {camera: located.camera}, self._state.robots)
        for index, readings in located.readings.items():
            entry = self.data.entries[index]
            entry.observation = entry.observation.read_as(readings).judged(Verdict.ACCEPTED)
            entry.map_from_base = located.map_from_base.get(index, entry.map_from_base)

    # -- the batch solution -----------------------------------------------------------------------

    def solve(self) -> None:
        """Solve over everything; observations that contradict the rest are set aside."""
        self._readmit()
        used = self.data.usable(self._state.cameras)
        if not used:
            return
        solution = assembled = None
        for round_ in range(_MOST_ROUNDS):
            is_rough = round_ == 0
            assembled, solution = self._solve_used(used, is_rough=is_rough)
            changed = judge.judge(self.data, assembled, solution.state)
            if not is_rough:
                changed |= repeated.share_out(self.data, assembled, solution.state)
            used = self.data.usable(self._state.cameras)
            if not used:
                return
            if round_ > 0 and not changed:
                break
        assert solution is not None
        assert assembled is not None
        self._solution, self._assembled = solution, assembled
        self._since_solve = 0
        self._history.clear()
        self._forget_unused(assembled)
        self._filter = Filter.after(self._state, assembled.problem, solution.reduced)
        self._guess_rest()
        self._drop_misplaced()

    def _readmit(self) -> None:
        """Give observations that were set aside another chance, and place those without a place."""
        for index, entry in enumerate(self.data.entries):
            observation = entry.observation
            if observation.camera not in self._state.cameras:
                continue
            if observation.outliers and observation.chosen is not None:
                entry.observation = observation.read_as(observation.chosen)
            if entry.map_from_base is None:
                self._guess(index)
            if entry.map_from_base is None or observation.verdict is Verdict.ACCEPTED:
                continue
            if self._filter is None or not self._filter.has_camera(observation.camera):
                continue  # located just now: the next solution looks at it again
            prior = self._loosely(observation, entry.map_from_base)
            aligned = self._aligned(self._filter, observation, prior)
            if aligned is None:
                continue
            is_rejected = observation.verdict is Verdict.REJECTED
            if not (is_rejected and _is_elsewhere(aligned[1], prior)):
                entry.observation = aligned[0].judged(Verdict.ACCEPTED)

    def _loosely(self, observation: Observation, map_from_base: Pose) -> RobotEstimate:
        """Where the robot stood by the sightings around: within a decimetre and a tenth of a
        radian, and what odometry may have drifted since the nearest one."""
        variance = np.repeat([0.01, 0.01], 3)
        robot, stamp_ns = observation.robot, observation.stamp_ns
        chain = self._assembled.problem.chains.get(robot) if self._assembled else None
        track = self.data.tracks[robot]
        if chain is not None and track.covers(stamp_ns):
            nearest = int(chain.stamps_ns[np.argmin(np.abs(chain.stamps_ns - stamp_ns))])
            if nearest != stamp_ns:
                moments = np.array(sorted([nearest, stamp_ns]))
                drift = np.diagonal(track.motion(moments, chain.scales).covariance[0])
                variance = variance + np.repeat([drift[:3].sum(), drift[3:].sum()], 3)
        return RobotEstimate(stamp_ns, map_from_base, np.diag(variance))

    def _solve_used(self, used: list[int], *, is_rough: bool) -> tuple[Assembled, Solution]:
        tolerance = _ROUGH_TOLERANCE if is_rough else self._tolerance
        solved = solve_consistently(
            self.data, self._state, used, huber=_HUBER if is_rough else np.inf, tolerance=tolerance
        )
        self._state = solved.state
        self.iterations += solved.iterations
        return solved.assembled, solved.solution

    def _forget_unused(self, assembled: Assembled) -> None:
        """Cameras all of whose observations were rejected are not located any more."""
        kept = {n: c for n, c in self._state.cameras.items() if n in assembled.problem.layout.pose}
        self._state = State(kept, self._state.robots)

    def _guess_rest(self) -> None:
        """Place every observation that is not used, by the new solution."""
        open_: dict[str, list[Entry]] = {}
        for entry in self.data.entries:
            if entry.observation.verdict is not Verdict.ACCEPTED:
                open_.setdefault(entry.observation.robot, []).append(entry)
        for robot, entries in open_.items():
            for entry, pose in zip(entries, self._poses_at(robot, entries), strict=True):
                entry.map_from_base = pose

    def _poses_at(self, robot: str, entries: list[Entry]) -> list[Pose | None]:
        """Where a robot stood at observations, by the last solution and odometry."""
        chain = self._assembled.problem.chains.get(robot) if self._assembled else None
        if chain is None:
            return [None] * len(entries)
        track = self.data.tracks[robot]
        stamps = np.array([entry.observation.stamp_ns for entry in entries])
        nodes = self._state.robots[robot].map_from_base
        moments = np.clip(stamps, track.first_ns, track.last_ns)
        poses = interpolated(track, chain, nodes, moments)
        return [poses[i] for i in range(len(entries))]

    def _drop_misplaced(self) -> None:
        """A camera most of whose observations contradict its place loses it, and starts anew."""
        for camera in list(self._state.cameras):
            if camera in self.data.known.poses:
                continue
            entries = self.data.of_camera(camera)
            accepted = sum(e.observation.verdict is Verdict.ACCEPTED for e in entries)
            if accepted * 2 >= len(entries):
                continue
            cameras = {n: c for n, c in self._state.cameras.items() if n != camera}
            self._state = State(cameras, self._state.robots)
            for entry in entries:
                entry.observation = entry.observation.judged(Verdict.PENDING)
            self._undetermined[camera] = ("its pictures contradict each other",)
            self._tries[camera] = len(entries)
            self.solve()
            return

    def finish(self) -> None:
        """Locate what can be located from all that came in, and solve to the end."""
        self._tolerance = _FINAL_TOLERANCE
        for _ in range(len(self.data.site.cameras) + 1):
            self.solve()
            missing = [
                name
                for name in self.data.site.cameras
                if name not in self._state.cameras and self.data.of_camera(name)
            ]
            found = [name for name in missing if self._locate(name)]
            if not found:
                break
        self._settle()

    def _settle(self) -> None:
        """Solve until what is rejected stays the same: a wrong observation draws good ones off."""
        for _ in range(_MOST_SETTLING):
            before = self._rejected()
            if not before:
                return
            self.solve()
            if self._rejected() == before:
                return

    def _rejected(self) -> set[int]:
        entries = self.data.entries
        return {i for i, e in enumerate(entries) if e.observation.verdict is Verdict.REJECTED}

    # -- output -----------------------------------------------------------------------------------

    def robot(self, robot: str) -> RobotEstimate | None:
        if self._filter is None or not self._filter.has_robot(robot):
            return None
        known = self._carried.get(robot)
        if known is not None and known[0] is self._filter:
            _, estimate, ahead = known
        else:
            estimate, ahead = self._filter.robot(self.data, robot), self._filter
        last_ns = self.data.tracks[robot].last_ns
        if robot in self._filter.reduced.layout.scales:
            ahead = ahead.carried(self.data, robot, last_ns)
            estimate = ahead.robot(self.data, robot)
        else:
            estimate = carried_on(self.data, robot, estimate, last_ns, ahead.scales(robot))
        self._carried[robot] = (self._filter, estimate, ahead)
        return estimate

    def cameras(self) -> dict[str, CameraEstimate]:
        if self._filter is None:
            return {}
        return camera_estimates(self._filter, list(self.data.site.cameras))

    @property
    def located_count(self) -> int:
        return len(self._state.cameras)

    def joint_covariance(self) -> Array:
        if self._filter is None:
            return np.zeros((0, 0))
        return joint_covariance(self._filter, list(self.data.site.cameras))

    def undetermined(self) -> dict[str, tuple[str, ...]]:
        seen = [name for name in self.data.site.cameras if self.data.of_camera(name)]
        pending = {
            name: self._undetermined.get(name, ("too few pictures of the robot so far",))
            for name in seen
            if name not in self._state.cameras
        }
        placed = self.cameras()
        loose = (n for n in seen if n in self._state.cameras and n not in placed)
        return pending | dict.fromkeys(loose, (_LOOSE,))

    def count(self, camera: str) -> CameraCount:
        entries = self.data.of_camera(camera)
        rejected = sum(e.observation.verdict is Verdict.REJECTED for e in entries)
        rms = None
        if self._assembled is not None and self._solution is not None:
            rms = judge.reprojection_rms_px(self._assembled.problem, self._solution.state, camera)
        return CameraCount(len(entries), rejected, rms)

    def trajectory(self, robot: str) -> Trajectory | None:
        track = self.data.tracks[robot]
        if self._assembled is None or robot not in self._assembled.problem.chains:
            if robot != self.data.anchored_robot or not len(track):
                return None
            return Trajectory(track.stamps_ns.copy(), track.odom_from_base)
        chain = self._assembled.problem.chains[robot]
        nodes = self._state.robots[robot].map_from_base
        return Trajectory(
            track.stamps_ns.copy(), interpolated(track, chain, nodes, track.stamps_ns)
        )

    def scales(self, robot: str) -> Array:
        return self._state.robots[robot].scales

    def base_from_faces(self, robot: str) -> Pose:
        return self._state.robots[robot].base_from_face

    @property
    def chi2_per_dof(self) -> float | None:
        if self._assembled is None or self._solution is None:
            return None
        return judge.chi2_per_dof(self._assembled.problem, self._solution)


def _is_elsewhere(map_from_base: Pose, prior: RobotEstimate) -> bool:
    """Whether a pose is more than five sigmas from where the robot stood."""
    apart = map_from_base.difference(prior.map_from_base)
    return bool(np.sum(apart**2 / np.diagonal(prior.covariance)) > 25.0)
