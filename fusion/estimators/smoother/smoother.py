"""The default estimator: a smoother over all robot poses and cameras, with a filter for the moment.

Each sighting updates the filter at once; the batch solution (`batch`) is redone when enough has
come in since the last one (so its cost stays a fixed share), and whenever a camera is located.
"""

import numpy as np
from scipy.linalg import LinAlgError

from trigpoint.fusion.association.explanation import Alternative
from trigpoint.fusion.estimators import outlier_rejection
from trigpoint.fusion.estimators.interface import CameraCount, CameraEstimate, Trajectory, Update
from trigpoint.fusion.estimators.marginals import joint_covariance
from trigpoint.fusion.estimators.residuals import CameraResiduals, camera_residuals
from trigpoint.fusion.model.dataset import DataSet, Entry
from trigpoint.fusion.model.observations import Observation
from trigpoint.fusion.model.odometry import Added
from trigpoint.fusion.model.trajectory import interpolated
from trigpoint.fusion.solver.filter import Filter, RobotEstimate
from trigpoint.fusion.solver.snapshot import GuidanceWorld
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from .batch import BatchSolution
from .camera_relocation import of_its_time
from .change_detection import ChangeDetector
from .change_reports import BEHIND_A_JUMP, report_changes
from .current_filter import CurrentFilter

_FIRST_SOLVE = 20
_SOLVE_SHARE = 0.1


class Smoother:
    """See `Estimator`."""

    def __init__(self, data: DataSet) -> None:
        self.data = data
        self._batch = BatchSolution(data)
        self._change_detector = ChangeDetector(self._batch)
        self._current = CurrentFilter(data)
        self._since_solve = 0
        # How often everything was solved anew.
        self.solutions = 0

    @property
    def iterations(self) -> int:
        return self._batch.iterations

    # -- input ------------------------------------------------------------------------------------

    def add_odometry(self, robot: str, stamp_ns: int, odom_from_base: Pose) -> Added:
        added = self.data.tracks[robot].add(stamp_ns, odom_from_base)
        self._current.begin(robot)
        return added

    def add_observation(self, observation: Observation) -> Update:
        if observation.is_repeat:
            return self._try(observation)
        batch = self._batch
        before = (batch.state, self._current.known, batch.solution, batch.assembled)
        count = len(self.data.entries)
        try:
            return self._add(observation)
        except (LinAlgError, ValueError) as reason:
            # Discard a numerically unusable observation; the state is as before it.
            self.data.forget_from(count)
            batch.state, known, batch.solution, batch.assembled = before
            self._current.go_on_from(known)
            return Update(problem=f"a sighting of {observation.camera} is unusable ({reason})")

    def _try(self, observation: Observation) -> Update:
        """The correction that an observation makes, of which nothing is learnt."""
        entry = Entry(of_its_time(self.data.moves, observation))
        try:
            return Update(correction=self._current.tried(entry, self._batch.state))
        except (LinAlgError, ValueError) as reason:
            return Update(problem=f"a sighting of {observation.camera} is unusable ({reason})")

    def collect(self, observation: Observation) -> None:
        self._batch.collected.append(of_its_time(self.data.moves, observation))

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
        self._go_on_from(self._batch.solve(self._current.known))

    def finish(self) -> None:
        before = list(self.data.changes)
        self._go_on_from(self._batch.finish(self._current.known))
        if self.data.changes != before:
            report_changes(self.data, self._batch.state)

    def _explain(self) -> bool:
        """Look for a change that explains what contradicts a robot; whether there was one."""
        before = list(self.data.changes)
        self.finish()
        self._change_detector = ChangeDetector(self._batch)
        return self.data.changes != before

    def _go_on_from(self, known: Filter | None) -> None:
        if known is not self._current.known:
            self._current.go_on_from(known, self.data.entries)
            self.solutions += 1
            self._since_solve = 0

    # -- an observation of a located camera -------------------------------------------------------

    def _use(self, index: int) -> Update:
        entry = self.data.entries[index]
        if self._current.known is None:
            return Update()
        if not self._current.known.has_robot(entry.observation.robot):
            return self._locate_robot(index)
        correction = self._current.use(entry, self._batch.state)
        self._since_solve += 1
        is_moved = self._change_detector.note(index, self._current.known)
        self._batch.undecided = self._change_detector.undecided
        if is_moved:
            self.solve()
            return Update()
        robot = entry.observation.robot
        if self._change_detector.is_robot_lifted(robot) and not self._explain():
            # No change explains it, so it was the filter that was wrong.
            self._change_detector.forget(robot)
            self._batch.undecided = self._change_detector.undecided
        return Update(correction=correction)

    def _locate_robot(self, index: int) -> Update:
        """A robot meets its first located cameras: locate its odometry frame in the map."""
        robot = self.data.entries[index].observation.robot
        if self._batch.locate_robot(robot, self._current.known):
            self.solve()
        return Update()

    # -- an observation of a camera that is not located -------------------------------------------

    def _guess(self, index: int) -> None:
        """The robot's pose, as far as it is known now."""
        entry = self.data.entries[index]
        observation = entry.observation
        entry.map_from_base = self._batch.pose_at(
            self._current.known, observation.robot, observation.stamp_ns
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

    @property
    def current(self) -> CurrentFilter:
        """What is known at the moment."""
        return self._current

    def robot(self, robot: str) -> RobotEstimate | None:
        return self._current.robot(robot)

    def cameras(self) -> dict[str, CameraEstimate]:
        return self._current.cameras()

    @property
    def located(self) -> list[str]:
        """Every place of a camera that is located."""
        return list(self._batch.state.cameras)

    @property
    def located_count(self) -> int:
        return len(self._batch.state.cameras)

    def joint_covariance(self) -> Array:
        if self._current.known is None:
            return np.zeros((0, 0))
        return joint_covariance(self._current.known, list(self.data.site.cameras))

    def undetermined(self) -> dict[str, tuple[str, ...]]:
        seen = [name for name in self.data.site.cameras if self.data.of_camera(name)]
        pending = {
            name: self._batch.undetermined.get(name, ("too few pictures of the robot so far",))
            for name in seen
            if name not in self._batch.state.cameras
        }
        placed = self.cameras()
        loose = (n for n in seen if n in self._batch.state.cameras and n not in placed)
        return pending | dict.fromkeys(loose, (BEHIND_A_JUMP,))

    def alternatives(self, camera: str) -> tuple[Alternative, ...]:
        finding = self._batch.finding(camera)
        return finding.alternatives if finding is not None and not finding.is_located else ()

    def is_confirmed(self, camera: str) -> bool:
        counted = self.count(camera)
        return counted.sightings - counted.rejected > 1

    def count(self, camera: str) -> CameraCount:
        places = self.data.places_of(camera)
        entries = [entry for place in places for entry in self.data.of_camera(place)]
        sightings = sum(len(entry.observation.views) for entry in entries)
        used = sum(entry.observation.used_views for entry in entries)
        rejected = sightings - used if camera in self._batch.state.cameras else 0
        rms = None
        if self._batch.assembled is not None and self._batch.solution is not None:
            rms = outlier_rejection.reprojection_rms_px(
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
        if self._current.known is None or assembled is None:
            return None
        return GuidanceWorld.of(
            self.data, self._current.known, assembled.problem, self._batch.state
        )

    def residuals(self, camera: str) -> CameraResiduals:
        assembled = self._batch.assembled
        problem = assembled.problem if assembled is not None else None
        return camera_residuals(self.data, problem, self._batch.state, camera)

    @property
    def chi2_per_dof(self) -> float | None:
        if self._batch.assembled is None or self._batch.solution is None:
            return None
        return outlier_rejection.chi2_per_dof(self._batch.assembled.problem, self._batch.solution)
