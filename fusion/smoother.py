"""The default estimator: a smoother over all robot poses and cameras, with a filter for the moment.

Each sighting updates the filter at once; the batch solution (`batch`) is redone when enough has
come in since the last one (so its cost stays a fixed share), and whenever a camera is located.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError

from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from . import judge
from .assembly import true_time_ns
from .batch import BatchSolution
from .contradictions import Contradictions, is_amiss
from .dataset import DataSet, Entry
from .estimator import CameraCount, CameraEstimate, Trajectory, Update
from .filter import Filter, RobotEstimate, carried_on
from .guidance_world import GuidanceWorld
from .moved import of_its_time
from .observations import Observation, Verdict, observation_of
from .odometry_track import Added
from .placement import align_to
from .residuals import CameraResiduals, camera_residuals
from .survey import camera_estimates, is_placed, joint_covariance
from .trajectory import interpolated

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
        self._batch = BatchSolution(data)
        self._contradictions = Contradictions(self._batch)
        self._filter: Filter | None = None
        self._history: deque[_Step] = deque(maxlen=_HISTORY)
        self._since_solve = 0
        # Where each robot is by its odometry since the filter's last step, and by which filter;
        # where scales are estimated, the filter carried on that far.
        self._carried: dict[str, tuple[Filter, RobotEstimate, Filter]] = {}

    @property
    def iterations(self) -> int:
        return self._batch.iterations

    # -- input ------------------------------------------------------------------------------------

    def add_odometry(self, robot: str, stamp_ns: int, odom_from_base: Pose) -> Added:
        added = self.data.tracks[robot].add(stamp_ns, odom_from_base)
        if self._filter is None and (robot == self.data.anchored_robot or self.data.known.poses):
            self._filter = Filter.at_origin(self.data)
        return added

    def add_observation(self, observation: Observation) -> Update:
        batch = self._batch
        before = (batch.state, self._filter, batch.solution, batch.assembled)
        count = len(self.data.entries)
        try:
            return self._add(observation)
        except (LinAlgError, ValueError) as reason:
            # Numbers that no arithmetic survives: the rest goes on as if they had not come.
            self.data.forget_from(count)
            batch.state, self._filter, batch.solution, batch.assembled = before
            self._history.clear()
            return Update(problem=f"a sighting of {observation.camera} is unusable ({reason})")

    def collect(self, observation: Observation) -> None:
        self._batch.collected.append(observation)

    def _add(self, observation: Observation) -> Update:
        observation = of_its_time(self.data.moves, observation)
        self.data.entries.append(Entry(observation))
        index = len(self.data.entries) - 1
        if observation.camera in self._batch.state.cameras:
            update = self._use(index)
        else:
            self._guess(index)
            update = self._try_to_locate(observation.camera)
        if self._is_solution_due():
            self.solve()
        return update

    def _is_solution_due(self) -> bool:
        due = max(_FIRST_SOLVE, _SOLVE_SHARE * len(self.data.entries))
        return bool(self._batch.state.cameras) and self._since_solve >= due

    # -- the batch solution -----------------------------------------------------------------------

    def solve(self) -> None:
        self._go_on_from(self._batch.solve(self._filter))

    def finish(self) -> None:
        was_collected = bool(self._batch.collected)
        self._go_on_from(self._batch.finish(self._filter))
        if was_collected and is_amiss(self._batch):
            self._go_through()
            self._go_on_from(self._batch.finish(self._filter))

    def _go_through(self) -> None:
        """Take everything in anew, sighting by sighting, so that it shows what happened when."""
        entries = sorted(self.data.entries, key=lambda entry: entry.observation.stamp_ns)
        self.data.forget_from(0)
        self._batch = BatchSolution(self.data)
        self._contradictions = Contradictions(self._batch)
        self._go_on_from(Filter.at_origin(self.data))
        for entry in entries:
            seen = entry.observation
            self.add_observation(observation_of(seen.camera, seen.robot, seen.stamp_ns, seen.views))

    def _go_on_from(self, known: Filter | None) -> None:
        if known is not self._filter:
            self._filter = known
            self._since_solve = 0
            self._history.clear()

    # -- an observation of a located camera -------------------------------------------------------

    def _use(self, index: int) -> Update:
        observation = self.data.entries[index].observation
        if self._filter is None:
            return Update()
        if not self._filter.has_robot(observation.robot):
            return self._tie(index)
        time_ns = true_time_ns(self.data, observation, self._batch.state)
        later = self._rewind(observation.robot, time_ns)
        correction = self._apply(index, time_ns)
        for step in later:
            self._apply(step.entry, step.time_ns)
        self._since_solve += 1
        if self._contradictions.note(index, self._filter):
            self.solve()
            return Update()
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
        aligned = align_to(self.data, current, entry.observation, predicted)
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

    def _tie(self, index: int) -> Update:
        """A robot meets its first located camera: its odometry gets its place in the map."""
        assert self._filter is not None
        entry = self.data.entries[index]
        aligned = align_to(self.data, self._filter, entry.observation, None)
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
        entry.map_from_base = self._batch.pose_at(
            self._filter, observation.robot, observation.stamp_ns
        )

    def _try_to_locate(self, camera: str) -> Update:
        """Try again whenever a camera's pictures have grown by half since the last try."""
        if not self._batch.is_due(camera):
            return Update()
        if self._batch.locate(camera):
            self.solve()
            return Update(located=(camera,) if camera in self._batch.state.cameras else ())
        return Update()

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
        if robot in self._filter.layout.scales:
            ahead = ahead.carried(self.data, robot, last_ns)
            estimate = ahead.robot(self.data, robot)
        else:
            estimate = carried_on(self.data, robot, estimate, last_ns, ahead.scales(robot))
        self._carried[robot] = (self._filter, estimate, ahead)
        return estimate

    def cameras(self) -> dict[str, CameraEstimate]:
        if self._filter is None:
            return {}
        last_ns = max(self._filter.stamps_ns.values(), default=self.data.epoch_ns)
        since_epoch_s = float(self.data.since_epoch_s(last_ns))
        names = list(self.data.site.cameras)
        return camera_estimates(self._filter, names, since_epoch_s=since_epoch_s)

    @property
    def located_count(self) -> int:
        return len(self._batch.state.cameras)

    def joint_covariance(self) -> Array:
        if self._filter is None:
            return np.zeros((0, 0))
        return joint_covariance(self._filter, list(self.data.site.cameras))

    def undetermined(self) -> dict[str, tuple[str, ...]]:
        seen = [name for name in self.data.site.cameras if self.data.of_camera(name)]
        pending = {
            name: self._batch.undetermined.get(name, ("too few pictures of the robot so far",))
            for name in seen
            if name not in self._batch.state.cameras
        }
        placed = self.cameras()
        loose = (n for n in seen if n in self._batch.state.cameras and n not in placed)
        return pending | dict.fromkeys(loose, (_LOOSE,))

    def count(self, camera: str) -> CameraCount:
        places = self.data.places_of(camera)
        entries = [entry for place in places for entry in self.data.of_camera(place)]
        sightings = sum(len(entry.observation.views) for entry in entries)
        used = sum(entry.observation.used_views for entry in entries)
        rejected = sightings - used if camera in self._batch.state.cameras else 0
        rms = None
        if self._batch.assembled is not None and self._batch.solution is not None:
            rms = judge.reprojection_rms_px(
                self._batch.assembled.problem, self._batch.solution.state, camera
            )
        return CameraCount(sightings, rejected, rms)

    def trajectory(self, robot: str) -> Trajectory | None:
        track = self.data.tracks[robot]
        if self._batch.assembled is None or robot not in self._batch.assembled.problem.chains:
            if robot != self.data.anchored_robot or not len(track):
                return None
            return Trajectory(track.stamps_ns.copy(), track.odom_from_base)
        chain = self._batch.assembled.problem.chains[robot]
        nodes = self._batch.state.robots[robot].map_from_base
        return Trajectory(
            track.stamps_ns.copy(), interpolated(track, chain, nodes, track.stamps_ns)
        )

    def scales(self, robot: str) -> Array:
        return self._batch.state.robots[robot].scales

    def base_from_faces(self, robot: str) -> Pose:
        return self._batch.state.robots[robot].base_from_face

    def guidance_world(self) -> GuidanceWorld | None:
        assembled = self._batch.assembled
        if self._filter is None or assembled is None:
            return None
        return GuidanceWorld.of(self.data, self._filter, assembled.problem, self._batch.state)

    def residuals(self, camera: str) -> CameraResiduals:
        assembled = self._batch.assembled
        problem = assembled.problem if assembled is not None else None
        return camera_residuals(self.data, problem, self._batch.state, camera)

    @property
    def chi2_per_dof(self) -> float | None:
        if self._batch.assembled is None or self._batch.solution is None:
            return None
        return judge.chi2_per_dof(self._batch.assembled.problem, self._batch.solution)
