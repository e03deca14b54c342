"""The default estimator: a smoother over all robot poses and cameras, with a filter for live use.

Each sighting of a located camera updates the filter at once. Any other one, or one that contradicts
the filter, is explained together with everything else (`explainer`), and the whole is solved anew
(`batch`).
"""

from collections import defaultdict

import numpy as np
from numpy.linalg import LinAlgError

from trigpoint.fusion.association.explanation import Alternative
from trigpoint.fusion.association.scales import rough_robots
from trigpoint.fusion.estimators.change_reports import report_changes
from trigpoint.fusion.estimators.explainer import Explainer
from trigpoint.fusion.estimators.interface import (
    CameraCount,
    CameraEstimate,
    Live,
    Trajectory,
    Update,
)
from trigpoint.fusion.estimators.marginals import joint_covariance
from trigpoint.fusion.estimators.residuals import (
    CameraResiduals,
    camera_residuals,
    chi2_per_dof,
    reprojection_rms_px,
)
from trigpoint.fusion.estimators.unfit_inputs import UnfitInputs, unfit_inputs
from trigpoint.fusion.model.dataset import CameraMove, DataSet, Entry
from trigpoint.fusion.model.observations import Observation, Verdict
from trigpoint.fusion.model.past import Past
from trigpoint.fusion.model.readings import Readings
from trigpoint.fusion.model.trajectory import interpolated
from trigpoint.fusion.solver.filter import Filter, RobotEstimate
from trigpoint.fusion.solver.snapshot import GuidanceWorld
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from .batch import BatchSolution
from .current_filter import CurrentFilter
from .settled_past import OF_A_SESSION, Limits, past_path, settled_past
from .unseen_moves import unseen_move


class Smoother(Live):
    """See `Estimator`. `limits`: on what it keeps; where robots look alike, a recording is kept
    whole, since of its sightings many come at the end."""

    def __init__(self, data: DataSet, limits: Limits = OF_A_SESSION) -> None:
        self.data, self._limits = data, limits
        self._past_paths: dict[str, list[Trajectory]] = defaultdict(list)
        self._is_kept_whole = limits.paths and data.has_alike_robots
        self._collected = 0
        self._asked_ns = -1  # until then it was asked which cameras were moved unseen
        self._explainer = Explainer(data)
        self._batch = BatchSolution(data)
        self._current = CurrentFilter(data)
        # How often everything was solved anew.
        self.solutions = 0

    @property
    def iterations(self) -> int:
        return self._batch.iterations

    # -- input ------------------------------------------------------------------------------------

    def add_odometry(self, robot: str, readings: Readings) -> list[int]:
        added = self.data.tracks[robot].add_run(readings)
        self._current.begin(robot)
        return added

    def add_observation(self, observation: Observation) -> Update:
        update = self.take(observation)
        if not self.is_due:
            return update
        before = self._batch.state.cameras
        self.finish()
        located = tuple(name for name in self._batch.state.cameras if name not in before)
        return Update(update.correction, located, update.problem)

    def take(self, observation: Observation) -> Update:
        """Use an observation in the filter alone; anything else is left to `finish`."""
        entry = Entry(self.data.concluded(observation))
        try:
            if observation.is_repeat:
                return Update(correction=self._current.tried(entry))
            correction = self._current.use(entry)
        except (LinAlgError, ValueError) as reason:
            return Update(problem=f"a sighting of {observation.camera} is unusable ({reason})")
        self.data.entries.append(entry)
        is_used = entry.observation.verdict is Verdict.ACCEPTED
        self._explainer.take(observation, is_used=is_used)
        return Update(correction=correction)

    def collect(self, observation: Observation) -> None:
        self._explainer.take(observation, is_used=False)
        self.data.entries.append(Entry(self.data.concluded(observation)))
        # Looked at whenever a tenth more is there.
        if len(self.data.entries) > 1.1 * self._collected:
            if self._is_much(is_open=False):
                self.finish()
            self._collected = len(self.data.entries)

    # -- the batch solution -----------------------------------------------------------------------

    @property
    def is_due(self) -> bool:
        """Whether so much is new, or unexplained, that everything is to be explained anew."""
        return self._explainer.is_due

    def camera_moved(self, move: CameraMove) -> None:
        if self.data.tell(move):
            self._explainer.camera_moved()

    def leave_open(self, cameras: frozenset[str]) -> None:
        self._explainer.leave_open(cameras)

    def finish(self) -> None:
        """Explain and solve everything that came, unless that is done already."""
        if not self._explainer.has_new or not self._solve():
            return
        if self._is_much(is_open=self._is_open) and self._summarise():
            self._solve()

    def _is_much(self, *, is_open: bool) -> bool:
        """Whether the older part of what came is to be summarised."""
        return not self._is_kept_whole and self._limits.is_reached(self.data, is_open=is_open)

    def _solve(self) -> bool:
        """Explain and solve everything; whether that succeeded."""
        before = list(self.data.changes)
        # Where little is known of the scales, a draft solution estimates them for the second one.
        is_rough = self._batch.solution is None and bool(rough_robots(self.data))
        try:
            if is_rough:
                self._batch.solve(self._explainer.explain(is_draft=True))
            known = self._solved()
        except (LinAlgError, ValueError) as reason:
            self.data.note(
                "unsolved", f"the newest observations could not be solved for yet ({reason})"
            )
            return False
        self._explainer.note(self.data.entries)
        self._current.go_on_from(known, self.data.entries, told=self.data.told)
        self.solutions += 1
        if any(change not in before for change in self.data.changes):
            report_changes(self.data, self._batch.state)
        return True

    def _solved(self) -> Filter:
        """Explain and solve everything, and anew with each move that only the solution shows."""
        known = self._batch.solve(self._explainer.explain(self._batch.scales))
        since_ns = self._asked_ns
        self._asked_ns = max(entry.observation.stamp_ns for entry in self.data.entries)
        for _ in self.data.site.cameras:
            try:
                move = unseen_move(self.data, self._batch.state, since_ns)
            except LinAlgError:  # what does not determine a place tells of no move
                break
            told, explanation = list(self.data.told), self._explainer.explanation
            if move is None or not self.data.tell(move):
                break
            try:
                known = self._batch.solve(self._explainer.explain(self._batch.scales))
            except (LinAlgError, ValueError):  # the solution before it stands
                self.data.told, self._explainer.explanation = told, explanation
                break
        return known

    @property
    def _is_open(self) -> bool:
        """Whether later sightings may still change what became of the earlier ones."""
        explanation = self._explainer.explanation
        assert explanation is not None  # asked once it is solved
        is_undecided = any(not each.is_located for each in explanation.findings.values())
        return is_undecided or any(not self.count(name).is_confirmed for name in self.cameras())

    def _summarise(self) -> bool:
        """Summarise the older part of what came; whether there is anything to go on from."""
        try:
            past = settled_past(self.data, self._batch.state, self._limits.since_ns(self.data))
        except (LinAlgError, ValueError):
            return False
        if past is not None:
            if self._limits.paths:
                self._keep_paths(past)
            self.data.forget(past)
            self._explainer.forget_past()
            self._batch.go_on_from_the_past()
        return past is not None

    def _keep_paths(self, past: Past) -> None:
        for robot in self.data.site.robots:
            path = self._recent_path(robot)
            if path is not None:
                self._past_paths[robot].append(past_path(path, past, robot))

    # -- output -----------------------------------------------------------------------------------

    @property
    def current(self) -> CurrentFilter:
        """The filter at the current moment."""
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
        return self._explainer.undetermined(self.cameras())

    def alternatives(self, camera: str) -> tuple[Alternative, ...]:
        return self._explainer.alternatives(camera)

    def count(self, camera: str) -> CameraCount:
        places, past = self.data.places_of(camera), self.data.past_of(camera)
        entries = [entry for place in places for entry in self.data.of_camera(place)]
        sightings = past.sightings + sum(len(entry.observation.views) for entry in entries)
        used = past.used + sum(entry.observation.used_views for entry in entries)
        rejected = sightings - used if camera in self._batch.state.cameras else 0
        rms = None
        if self._batch.problem is not None:
            rms = reprojection_rms_px(self._batch.problem, self._batch.state, camera)
        return CameraCount(sightings, rejected, rms)

    def trajectory(self, robot: str) -> Trajectory | None:
        recent = self._recent_path(robot)
        every = [*self._past_paths[robot], *([recent] if recent is not None else [])]
        if len(every) < 2:
            return every[0] if every else None
        poses = Pose.joined(path.map_from_base for path in every)
        return Trajectory(np.concatenate([path.stamps_ns for path in every]), poses)

    def _recent_path(self, robot: str) -> Trajectory | None:
        """The path over the odometry that is kept."""
        track, problem = self.data.tracks[robot], self._batch.problem
        if problem is None or robot not in problem.chains:
            if robot != self.data.anchored_robot or not len(track):
                return None
            return Trajectory(track.stamps_ns.copy(), track.odom_from_base)
        nodes = self._batch.state.robots[robot].map_from_base
        chain = problem.chains[robot]
        poses = interpolated(track, chain.scales, chain.stamps_ns, nodes, track.stamps_ns)
        return Trajectory(track.stamps_ns.copy(), poses)

    def scales(self, robot: str) -> Array:
        return self._batch.state.robots[robot].scales

    def base_from_faces(self, robot: str) -> Pose:
        return self._batch.state.robots[robot].base_from_face

    def guidance_world(self) -> GuidanceWorld | None:
        known, problem = self._current.known, self._batch.problem
        if known is None or problem is None:
            return None
        return GuidanceWorld.of(self.data, known, problem, self._batch.state)

    def residuals(self, camera: str) -> CameraResiduals:
        return camera_residuals(self.data, self._batch.problem, self._batch.state, camera)

    def unfit_inputs(self) -> UnfitInputs:
        problem, solution = self._batch.problem, self._batch.solution
        if problem is None or solution is None:
            return UnfitInputs()
        scale = chi2_per_dof(problem, solution) or 1.0
        try:
            return unfit_inputs(self.data, problem, self._batch.state, solution.reduced, scale)
        except LinAlgError:  # what does not determine the rest tells of nothing given
            return UnfitInputs()

    @property
    def chi2_per_dof(self) -> float | None:
        if self._batch.problem is None or self._batch.solution is None:
            return None
        return chi2_per_dof(self._batch.problem, self._batch.solution)
