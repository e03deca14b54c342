"""An estimator that processes the sightings one by one, in order of time, as both filters do.

What happened in the session is explained as for the smoother (`explainer`). `replay` decides which
sighting comes next; `filter_state` is the filter's own state. Results are given out here.
"""

from collections.abc import Callable

import numpy as np
from numpy.linalg import LinAlgError

from trigpoint.fusion.association.events import Events
from trigpoint.fusion.association.explanation import Alternative
from trigpoint.fusion.estimators.change_reports import report_changes
from trigpoint.fusion.estimators.explained_data import explained, left_open
from trigpoint.fusion.estimators.explainer import Explainer
from trigpoint.fusion.estimators.interface import (
    CameraCount,
    CameraEstimate,
    Live,
    Trajectory,
    Update,
)
from trigpoint.fusion.model.dataset import CameraMove, DataSet, Entry
from trigpoint.fusion.model.observations import Observation, Verdict, base_from_faces
from trigpoint.fusion.model.readings import Readings
from trigpoint.fusion.model.trajectory import interpolated
from trigpoint.fusion.solver.filter import RobotEstimate, carried_on, is_placed
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from .filter_state import FilterState, Innovation
from .replay import Replay, Step, contradictions


class SequentialEstimator(Live):
    """See `Estimator`. `origin`: the filter state before any sighting."""

    def __init__(self, data: DataSet, origin: Callable[[DataSet], FilterState]) -> None:
        self.data, self._replay = data, Replay(data, origin)
        self._explainer = Explainer(data)
        # Until when contradictions were reported, by camera or robot.
        self._told_ns: dict[str, int] = {}
        self._carried: dict[str, tuple[FilterState, RobotEstimate]] = {}
        self._told: frozenset[CameraMove] = frozenset()
        self.iterations = 0

    # -- input ------------------------------------------------------------------------------------

    def add_odometry(self, robot: str, readings: Readings) -> list[int]:
        added = self.data.tracks[robot].add_run(readings)
        self._replay.begin(robot)
        return added

    def add_observation(self, observation: Observation) -> Update:
        if observation.is_repeat and self._is_outdated(observation):
            return Update()
        if observation.is_repeat:
            return Update(correction=self._known_place(observation))
        index = len(self.data.entries)
        self.data.entries.append(Entry(self.data.concluded(observation)))
        if self._is_outdated(observation):
            self._explainer.take(observation, is_used=False)
            return self._explained_where_due(None)
        try:
            correction = self._replay.insert(index)
        except (LinAlgError, ValueError) as reason:
            self.data.forget_from(index)
            return Update(problem=f"a sighting of {observation.camera} is unusable ({reason})")
        verdict = self.data.entries[index].observation.verdict
        self._explainer.take(observation, is_used=verdict is Verdict.ACCEPTED)
        return self._explained_where_due(correction)

    def _is_outdated(self, observation: Observation) -> bool:
        """Whether an observation may be from another place of its camera than the known one."""
        return self.data.is_outdated(observation, self._told)

    def _explained_where_due(self, correction: RobotEstimate | None) -> Update:
        """The update by an observation; where much is unexplained by now, all of it anew."""
        if not self._explainer.has_unexplained:
            return Update(correction=correction)
        before_it = set(self._filter_state.cameras)
        self.finish()
        located = tuple(name for name in self._filter_state.cameras if name not in before_it)
        return Update(correction, located)

    @property
    def _filter_state(self) -> FilterState:
        return self._replay.filter_state

    def collect(self, observation: Observation) -> None:
        self._explainer.take(observation, is_used=False)
        self.data.entries.append(Entry(observation))

    def _known_place(self, observation: Observation) -> RobotEstimate | None:
        """The pose of a robot in a repeated sighting; None unless the last one was accepted."""
        seen = self.data.of_camera(observation.camera)
        of_robot = (e for e in reversed(seen) if e.observation.robot == observation.robot)
        last = next(of_robot, None)
        if last is None or last.observation.verdict is not Verdict.ACCEPTED:
            return None
        estimate = self.robot(observation.robot)
        is_known = estimate is not None and is_placed(estimate.covariance)
        return estimate if is_known else None

    def _tell(self, steps: list[Step]) -> None:
        """Report once each run of sightings among these that contradict the rest."""
        for found in contradictions(self.data, steps):
            if found.since_ns > self._told_ns.get(found.what, -1):
                self.data.note("contradictions", found.text)
            self._told_ns[found.what] = found.until_ns

    # -- all of it anew ---------------------------------------------------------------------------

    def camera_moved(self, move: CameraMove) -> None:
        if self.data.tell(move):
            self._explainer.camera_moved()
            self.finish()

    def leave_open(self, cameras: frozenset[str]) -> None:
        self._explainer.leave_open(cameras)

    def finish(self) -> None:
        """Explain everything that came, unless that is done already, and process what the
        explanation uses from the beginning, in order of time."""
        replay = self._replay
        if not replay.has_begun or not self._explainer.has_new:
            return
        before = list(self.data.changes)
        explanation = self._explainer.explain()
        draft, state = explained(self.data, explanation)
        self.data.take_over(draft)
        self._explainer.note(self.data.entries)
        events = Events(self.data.site.fusion.priors)
        replay.restart(state.cameras, left_open(state, explanation, events))
        self._told = frozenset(self.data.told)
        self.iterations += 1
        if self.data.changes != before:
            report_changes(self.data, state)
        self._tell(replay.steps)

    # -- output -----------------------------------------------------------------------------------

    def robot(self, robot: str) -> RobotEstimate | None:
        filter_state, known = self._filter_state, self._carried.get(robot)
        if robot not in filter_state.stamps_ns:
            return None
        estimate = known[1] if known and known[0] is filter_state else filter_state.robot(robot)
        last_ns = self.data.tracks[robot].last_ns
        estimate = carried_on(self.data, robot, estimate, last_ns, filter_state.scales(robot))
        self._carried[robot] = (filter_state, estimate)
        return estimate

    def particles(self, robot: str) -> Pose | None:
        if robot not in self._filter_state.stamps_ns:
            return None
        now = self._filter_state.advanced(self.data, robot, self.data.tracks[robot].last_ns)
        return now.particles(robot)

    def cameras(self) -> dict[str, CameraEstimate]:
        """The located cameras whose pose in the map is known, in the site's order."""
        filter_state = self._filter_state
        here = [name for name in self.data.site.cameras if name in filter_state.cameras]
        estimates = {name: filter_state.estimate(name) for name in here}
        return {name: e for name, e in estimates.items() if is_placed(e.covariance)}

    @property
    def located_count(self) -> int:
        return len(self._filter_state.cameras)

    def joint_covariance(self) -> Array:
        placed = list(self.cameras())
        return self._filter_state.joint_covariance(placed) if placed else np.zeros((0, 0))

    def undetermined(self) -> dict[str, tuple[str, ...]]:
        return self._explainer.undetermined(self.cameras())

    def alternatives(self, camera: str) -> tuple[Alternative, ...]:
        return self._explainer.alternatives(camera)

    def count(self, camera: str) -> CameraCount:
        entries = self.data.of_camera(camera)
        sightings = sum(len(entry.observation.views) for entry in entries)
        used = sum(entry.observation.used_views for entry in entries)
        rejected = sightings - used if self._replay.is_located(camera) else 0
        squares = [innovation.rms_px**2 for innovation in self._innovations(camera)]
        rms_px = float(np.sqrt(np.mean(squares))) if squares else None
        return CameraCount(sightings, rejected, rms_px)

    def _innovations(self, camera: str | None = None) -> list[Innovation]:
        """Those of the used sightings, of all cameras or of one."""
        return [
            step.innovation
            for step in self._replay.steps
            if step.innovation is not None
            and camera in (None, self.data.entries[step.entry].observation.camera)
        ]

    def trajectory(self, robot: str) -> Trajectory | None:
        track = self.data.tracks[robot]
        is_origin = robot == self.data.anchored_robot and len(track)
        nodes = {track.first_ns: track.odom_from_base[0]} if is_origin else {}
        for step in self._replay.steps:
            is_mine = self.data.entries[step.entry].observation.robot == robot
            if is_mine and step.map_from_base is not None:
                nodes[step.time_ns] = step.map_from_base
        if not nodes:
            return None
        nodes_ns, poses = np.array(list(nodes)), Pose.stack(list(nodes.values()))
        return Trajectory(
            track.stamps_ns.copy(),
            interpolated(track, self.scales(robot), nodes_ns, poses, track.stamps_ns),
        )

    def scales(self, robot: str) -> Array:
        return self._filter_state.scales(robot)

    def base_from_faces(self, robot: str) -> Pose:
        return base_from_faces(self.data.targets[robot])

    @property
    def chi2_per_dof(self) -> float | None:
        used = self._innovations()
        freedom = sum(innovation.total_freedom for innovation in used)
        return sum(innovation.total for innovation in used) / freedom if freedom > 0 else None
