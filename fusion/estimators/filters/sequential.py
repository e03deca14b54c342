"""An estimator that processes the sightings one by one, in order of time, as both filters do.

`replay` decides which sighting comes next and how it is read; `filter_state` is the filter's own.
Here cameras are located and results given out.
"""

from collections.abc import Callable

import numpy as np
from scipy.linalg import LinAlgError

from trigpoint.fusion.association.explanation import Alternative
from trigpoint.fusion.estimators.interface import CameraCount, CameraEstimate, Trajectory, Update
from trigpoint.fusion.initialisation.cameras import Undetermined, locate
from trigpoint.fusion.model.dataset import DataSet, Entry
from trigpoint.fusion.model.observations import Observation, Verdict, base_from_faces
from trigpoint.fusion.model.odometry import Added
from trigpoint.fusion.solver.filter import RobotEstimate, carried_on, is_placed
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from .filter_state import FilterState
from .history import Step, chi2_per_dof, contradictions, nodes_of, place, poses_at, rms_px
from .replay import Replay

_LEAST_PICTURES_LIVE = 3
_LEAST_TO_DROP = 4
# Among so many sightings contradictions are looked for on the way.
_RECENT = 64
_LOOSE = (
    "position and orientation in the map: the robot was not located in it any more when it "
    "came here, since its odometry jumped or it was carried; drive there without a break"
)


class SequentialEstimator:
    """See `Estimator`. `origin`: the filter state before any sighting."""

    def __init__(self, data: DataSet, origin: Callable[[DataSet], FilterState]) -> None:
        self.data, self._origin = data, origin
        # None before the odometry that fixes the map begins.
        self._replay: Replay | None = None
        self._undetermined: dict[str, tuple[str, ...]] = {}
        self._tries: dict[str, int] = {}
        # Until when contradictions were told, by what they are of.
        self._told_ns: dict[str, int] = {}
        self._carried: dict[str, tuple[FilterState, RobotEstimate]] = {}
        self.iterations = 0

    # -- input ------------------------------------------------------------------------------------

    def add_odometry(self, robot: str, stamp_ns: int, odom_from_base: Pose) -> Added:
        added = self.data.tracks[robot].add(stamp_ns, odom_from_base)
        if self._replay is None and (robot == self.data.anchored_robot or self.data.known.poses):
            self._replay = Replay(self.data, self._origin)
        return added

    def add_observation(self, observation: Observation) -> Update:
        if observation.is_repeat:
            return Update(correction=self._known_place(observation))
        index = len(self.data.entries)
        self.data.entries.append(Entry(observation))
        if self._replay is None:
            return Update()
        before = self._replay.copy()
        try:
            return self._use(self._replay, index)
        except (LinAlgError, ValueError) as reason:
            # Discard a numerically unusable observation; the state is as before it.
            self.data.forget_from(index)
            self._replay = before
            return Update(problem=f"a sighting of {observation.camera} is unusable ({reason})")

    def _known_place(self, observation: Observation) -> RobotEstimate | None:
        """Where a robot stands that a camera sees as it did when its sighting was accepted."""
        seen = self.data.of_camera(observation.camera)
        of_robot = (e for e in reversed(seen) if e.observation.robot == observation.robot)
        last = next(of_robot, None)
        if last is None or last.observation.verdict is not Verdict.ACCEPTED:
            return None
        estimate = self.robot(observation.robot)
        is_known = estimate is not None and is_placed(estimate.covariance)
        return estimate if is_known else None

    def _use(self, replay: Replay, index: int) -> Update:
        camera = self.data.entries[index].observation.camera
        if not replay.is_located(camera):
            place(self.data, replay.filter_state, replay.steps, [index])
            replay.wait(camera)
            return self._try_to_locate(replay, camera)
        correction = replay.insert(index)
        if self.data.entries[index].observation.verdict is Verdict.REJECTED:
            self._drop_misplaced(replay, camera)
            self._tell(replay.steps[-_RECENT:])
        return Update(correction=correction)

    # -- cameras that are not located -------------------------------------------------------------

    def _try_to_locate(self, replay: Replay, camera: str) -> Update:
        """Try again whenever a camera's pictures have grown by half since the last try."""
        pictures = len(self.data.of_camera(camera))
        if pictures < max(_LEAST_PICTURES_LIVE, 1.5 * self._tries.get(camera, 0)):
            return Update()
        self._tries[camera] = pictures
        if not self._locate(replay, camera):
            return Update()
        if not replay.enter(camera, self._entries_of(camera)):
            self._forget(replay, camera, _LOOSE)
            return Update()
        return Update(located=(camera,))

    def _entries_of(self, camera: str) -> list[int]:
        return [i for i, e in enumerate(self.data.entries) if e.observation.camera == camera]

    def _locate(self, replay: Replay, camera: str) -> bool:
        """Locate a camera by all of its sightings, from the estimated poses of the robot."""
        place(self.data, replay.filter_state, replay.steps, self._entries_of(camera))
        result = locate(self.data, replay.state(), camera)
        if isinstance(result, Undetermined):
            self._undetermined[camera] = result.reasons
            return False
        self._undetermined.pop(camera, None)
        replay.located[camera] = result
        for index, readings in result.readings.items():
            entry = self.data.entries[index]
            entry.observation = entry.observation.read_as(readings)
        return True

    def _forget(self, replay: Replay, camera: str, reason: str) -> None:
        replay.located.pop(camera, None)
        self._undetermined[camera] = (reason,)
        for entry in self.data.of_camera(camera):
            entry.observation = entry.observation.judged(Verdict.PENDING)

    def _drop_misplaced(self, replay: Replay, camera: str) -> None:
        """Drop a camera most of whose sightings contradict its pose; it is located anew."""
        if camera in self.data.known.poses:
            return
        entries = self.data.of_camera(camera)
        rejected = sum(entry.observation.verdict is Verdict.REJECTED for entry in entries)
        if len(entries) < _LEAST_TO_DROP or rejected * 2 <= len(entries):
            return
        self._forget(replay, camera, "its pictures contradict each other")
        self._tries[camera] = len(entries)
        self.solve()
        replay.wait(camera)

    def _tell(self, steps: list[Step]) -> None:
        """Report once each run of sightings among these that contradict the rest."""
        for found in contradictions(self.data, steps):
            if found.since_ns > self._told_ns.get(found.what, -1):
                self.data.note("contradictions", found.text)
            self._told_ns[found.what] = found.until_ns

    # -- all of it anew ---------------------------------------------------------------------------

    def solve(self) -> None:
        """Process everything from the beginning, in order of time."""
        if self._replay is not None:
            self.iterations += 1
            self._replay.restart()

    def finish(self) -> None:
        """Locate every camera that can be located, and process the sightings that came too late."""
        replay = self._replay
        if replay is None:
            return
        while True:
            missing = [n for n in self.data.site.cameras if not replay.is_located(n)]
            found = [n for n in missing if self.data.of_camera(n) and self._locate(replay, n)]
            if found or not replay.is_complete():
                self.solve()
            loose = [name for name in found if name not in replay.filter_state.cameras]
            for name in loose:
                self._forget(replay, name, _LOOSE)
            if len(found) == len(loose):
                break
        self._tell(replay.steps)

    # -- output -----------------------------------------------------------------------------------

    def robot(self, robot: str) -> RobotEstimate | None:
        if self._replay is None or robot not in self._replay.filter_state.stamps_ns:
            return None
        filter_state, known = self._replay.filter_state, self._carried.get(robot)
        estimate = known[1] if known and known[0] is filter_state else filter_state.robot(robot)
        last_ns = self.data.tracks[robot].last_ns
        estimate = carried_on(self.data, robot, estimate, last_ns, filter_state.scales(robot))
        self._carried[robot] = (filter_state, estimate)
        return estimate

    def particles(self, robot: str) -> Pose | None:
        """Places where the robot may be at its last odometry message, all equally likely."""
        if self._replay is None or robot not in self._replay.filter_state.stamps_ns:
            return None
        now = self._replay.filter_state.advanced(self.data, robot, self.data.tracks[robot].last_ns)
        return now.particles(robot)

    def cameras(self) -> dict[str, CameraEstimate]:
        """The located cameras whose pose in the map is known, in the site's order."""
        if self._replay is None:
            return {}
        filter_state = self._replay.filter_state
        here = [name for name in self.data.site.cameras if name in filter_state.cameras]
        estimates = {name: filter_state.estimate(name) for name in here}
        return {name: e for name, e in estimates.items() if is_placed(e.covariance)}

    @property
    def located_count(self) -> int:
        return len(self._replay.filter_state.cameras) if self._replay is not None else 0

    def joint_covariance(self) -> Array:
        placed = list(self.cameras())
        if self._replay is None or not placed:
            return np.zeros((0, 0))
        return self._replay.filter_state.joint_covariance(placed)

    def undetermined(self) -> dict[str, tuple[str, ...]]:
        placed = self.cameras()
        return {
            name: self._undetermined.get(name, ("too few pictures of the robot so far",))
            for name in self.data.site.cameras
            if name not in placed and self.data.of_camera(name)
        }

    def alternatives(self, camera: str) -> tuple[Alternative, ...]:
        assert camera in self.data.site.cameras
        return ()  # a filter keeps one filter state

    def is_confirmed(self, camera: str) -> bool:
        counted = self.count(camera)
        return counted.sightings - counted.rejected > 1

    def count(self, camera: str) -> CameraCount:
        entries = self.data.of_camera(camera)
        sightings = sum(len(entry.observation.views) for entry in entries)
        if self._replay is None:
            return CameraCount(sightings, 0, None)
        used = sum(entry.observation.used_views for entry in entries)
        rejected = sightings - used if self._replay.is_located(camera) else 0
        return CameraCount(sightings, rejected, rms_px(self.data, self._replay.steps, camera))

    def trajectory(self, robot: str) -> Trajectory | None:
        if self._replay is None:
            return None
        stamps_ns = self.data.tracks[robot].stamps_ns
        nodes = nodes_of(self.data, self._replay.steps, robot)
        if not nodes:
            return None
        poses = poses_at(self.data, self._replay.filter_state, robot, nodes, stamps_ns)
        return Trajectory(stamps_ns.copy(), poses)

    def scales(self, robot: str) -> Array:
        return self._replay.filter_state.scales(robot) if self._replay is not None else np.zeros(2)

    def base_from_faces(self, robot: str) -> Pose:
        return base_from_faces(self.data.targets[robot])

    @property
    def chi2_per_dof(self) -> float | None:
        return chi2_per_dof(self._replay.steps) if self._replay is not None else None
