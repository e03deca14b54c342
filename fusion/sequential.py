"""An estimator that goes through the sightings one by one, in order of time: both filters do.

It says which sighting comes next and how it is read; what is believed then is the filter's own
affair (`belief`). Beliefs are immutable: a late sighting goes back to the belief before it and
takes what followed again, as far as the last 64 sightings reach; an older one enters when the
session is worked out to the end. A camera that is located goes back to its first sighting alike.
"""

import bisect
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.linalg import LinAlgError

from trigpoint.clock import to_ns
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from .belief import Belief, Surprise
from .dataset import DataSet, Entry
from .estimator import CameraCount, CameraEstimate, Trajectory, Update
from .filter import RobotEstimate, carried_on
from .locate import Located, Undetermined, locate
from .observations import Observation, Verdict, base_from_faces
from .odometry_track import Added
from .problem import State
from .sighting_use import first_sight, is_expected, predicted_at, sight_of
from .steps import Step, nodes_of, poses_at
from .survey import is_placed

_HISTORY = 64
# A camera's pictures wait for it to be located while so many others are used.
_MOST_REPLAYED = 256
_LEAST_PICTURES_LIVE = 3
# So many sightings in a row by two cameras or more that contradict where the robot is believed to
# be: it was carried.
_CARRIED = 4
_LEAST_TO_DROP = 4
_LOOSE = (
    "position and orientation in the map: the robot was not tied to it any more when it came here, "
    "since its odometry jumped or it was carried; drive there without a break"
)


class SequentialEstimator:
    """See `Estimator`. `origin`: the belief before any sighting."""

    def __init__(self, data: DataSet, origin: Callable[[DataSet], Belief]) -> None:
        self.data = data
        self._origin = origin
        self._belief: Belief | None = None
        self._steps: list[Step] = []
        self._located: dict[str, Located] = {}
        # The step before which each camera that is not located was first seen, and the belief then.
        self._waiting: dict[str, tuple[int, Belief]] = {}
        self._undetermined: dict[str, tuple[str, ...]] = {}
        self._tries: dict[str, int] = {}
        self._carried: dict[str, tuple[Belief, RobotEstimate]] = {}
        self.iterations = 0

    # -- input ------------------------------------------------------------------------------------

    def add_odometry(self, robot: str, stamp_ns: int, odom_from_base: Pose) -> Added:
        added = self.data.tracks[robot].add(stamp_ns, odom_from_base)
        if self._belief is None and (robot == self.data.anchored_robot or self.data.known.poses):
            self._belief = self._origin(self.data)
        return added

    def add_observation(self, observation: Observation) -> Update:
        before = (self._belief, list(self._steps), dict(self._waiting), dict(self._located))
        count = len(self.data.entries)
        try:
            return self._add(observation)
        except (LinAlgError, ValueError) as reason:
            # Numbers that no arithmetic survives: the rest goes on as if they had not come.
            del self.data.entries[count:]
            self._belief, self._steps, self._waiting, self._located = before
            return Update(problem=f"a sighting of {observation.camera} is unusable ({reason})")

    def _add(self, observation: Observation) -> Update:
        self.data.entries.append(Entry(observation))
        index = len(self.data.entries) - 1
        if self._belief is None:
            return Update()
        if self._is_located(observation.camera):
            return Update(correction=self._insert(index))
        self._place([index])
        self._wait(observation.camera)
        return self._try_to_locate(observation.camera)

    def _is_located(self, camera: str) -> bool:
        return camera in self._located or camera in self.data.known.poses

    # -- going through the sightings --------------------------------------------------------------

    def _time_ns(self, index: int) -> int:
        """When the robot stood as it was seen: stamp minus the camera's time offset."""
        observation, offset_s = self.data.entries[index].observation, 0.0
        belief = self._belief
        if belief is not None and observation.camera in belief.cameras:
            offset_s = belief.camera(observation.camera).time_offset_s
        track = self.data.tracks[observation.robot]
        return int(np.clip(observation.stamp_ns - to_ns(offset_s), track.first_ns, track.last_ns))

    def _insert(self, index: int) -> RobotEstimate | None:
        """Use a sighting at its place in time; None where it makes no correction."""
        time_ns = self._time_ns(index)
        place = bisect.bisect_right(self._steps, time_ns, key=lambda step: step.time_ns)
        later = self._rewind(place)
        if later is None:
            return None  # older than the history
        correction = self._apply(index)
        for step in later:
            self._apply(step.entry)
        if self.data.entries[index].observation.verdict is Verdict.REJECTED:
            self._drop_misplaced(self.data.entries[index].observation.camera)
        return correction

    def _rewind(self, place: int) -> list[Step] | None:
        """Go back before a step; the steps to do again, None where that is too long ago."""
        if place == len(self._steps):
            return []
        before = self._steps[place].before
        if before is None:
            return None
        return self._back_to(place, before)

    def _back_to(self, place: int, belief: Belief) -> list[Step]:
        later, self._steps = self._steps[place:], self._steps[:place]
        self._belief = belief
        for camera, (first, _) in self._waiting.items():
            if first > place:
                self._waiting[camera] = (place, belief)
        return later

    def _apply(self, index: int) -> RobotEstimate | None:
        """Go on by one sighting; where the robot is then, None where it is not used."""
        before, entry = self._belief, self.data.entries[index]
        assert before is not None
        robot, camera = entry.observation.robot, entry.observation.camera
        time_ns = max(self._time_ns(index), before.stamps_ns.get(robot, 0))
        if camera in before.cameras:
            after = self._used(before, entry, time_ns)
        else:
            after = self._begun(before, index, time_ns)
        step = Step(time_ns, index, before, None, None)
        self._steps.append(step)
        if len(self._steps) > _HISTORY:
            self._steps[-_HISTORY - 1].before = None
        if after is None:
            verdict = Verdict.REJECTED if self._is_used(before, index) else Verdict.PENDING
            entry.observation = entry.observation.judged(verdict)
            self._belief = self._unless_carried(before, robot)
            return None
        self._belief, step.surprise = after
        estimate = self._belief.robot(robot)
        entry.observation = entry.observation.judged(Verdict.ACCEPTED)
        entry.map_from_base = step.map_from_base = estimate.map_from_base
        is_new = camera not in before.cameras
        return estimate if not is_new and is_placed(estimate.covariance) else None

    def _is_used(self, belief: Belief, index: int) -> bool:
        """Whether a sighting could have been used: what comes before its camera's first sighting,
        or while the robot may be anywhere, says nothing yet."""
        observation = self.data.entries[index].observation
        if observation.camera in belief.cameras:
            return True
        read = self._located[observation.camera].readings
        robots = {self.data.entries[i].observation.robot for i in read}
        return observation.robot in robots and observation.robot in belief.stamps_ns

    def _used(self, before: Belief, entry: Entry, time_ns: int) -> tuple[Belief, Surprise] | None:
        """With a sighting by a camera of the belief, where it does not contradict it."""
        robot = entry.observation.robot
        belief, predicted = predicted_at(self.data, before, robot, time_ns)
        if predicted is not None:
            entry.map_from_base = predicted.map_from_base
        sight = sight_of(self.data, belief, entry.observation, predicted)
        if sight is None:
            return None
        entry.observation = sight.observation
        updated = belief.updated(self.data, sight)
        if updated is None or not is_expected(updated[1]):
            return None
        return updated

    def _begun(self, before: Belief, index: int, time_ns: int) -> tuple[Belief, Surprise] | None:
        """With the first sighting of a camera that was located by all of its sightings."""
        entry = self.data.entries[index]
        observation = entry.observation
        found = self._located[observation.camera]
        belief, predicted = predicted_at(self.data, before, observation.robot, time_ns)
        if predicted is None or index not in found.map_from_base or observation.chosen is None:
            return None
        sight = first_sight(self.data, observation, found, found.map_from_base[index])
        if sight is None:
            return None
        entry.observation = sight.observation
        return belief.with_camera(self.data, sight, found.camera)

    def _unless_carried(self, belief: Belief, robot: str) -> Belief:
        """Without the robot, where its last sightings say that it is somewhere else."""
        cameras: list[str] = []
        for step in reversed(self._steps[-_HISTORY:]):
            observation = self.data.entries[step.entry].observation
            if observation.robot == robot:
                if step.surprise is not None:
                    break
                cameras.append(observation.camera)
        if len(cameras) < _CARRIED or len(set(cameras)) < 2 or robot not in belief.stamps_ns:
            return belief
        return belief.without_robot(robot)

    # -- cameras that are not located -------------------------------------------------------------

    def _wait(self, camera: str) -> None:
        assert self._belief is not None
        first = self._waiting.get(camera)
        if first is None or len(self._steps) - first[0] > _MOST_REPLAYED:
            self._waiting[camera] = (len(self._steps), self._belief)

    def _try_to_locate(self, camera: str) -> Update:
        """Try again whenever a camera's pictures have grown by half since the last try."""
        pictures = len(self.data.of_camera(camera))
        if pictures < max(_LEAST_PICTURES_LIVE, 1.5 * self._tries.get(camera, 0)):
            return Update()
        self._tries[camera] = pictures
        if not self._locate(camera):
            return Update()
        place, belief = self._waiting.pop(camera)
        later = [step.entry for step in self._back_to(place, belief)]
        since_ns = self._steps[-1].time_ns if self._steps else 0
        mine = [i for i in self._entries_of(camera) if self._time_ns(i) >= since_ns]
        for index in sorted([*later, *mine], key=lambda i: (self._time_ns(i), i)):
            self._apply(index)
        assert self._belief is not None
        if camera not in self._belief.cameras:
            self._forget(camera, _LOOSE)
            self._waiting[camera] = (place, belief)
            return Update()
        return Update(located=(camera,))

    def _entries_of(self, camera: str) -> list[int]:
        return [i for i, e in enumerate(self.data.entries) if e.observation.camera == camera]

    def _locate(self, camera: str) -> bool:
        """Find a camera by all of its sightings, from where the robot is believed to have been."""
        self._place(self._entries_of(camera))
        result = locate(self.data, self._state(), camera)
        if isinstance(result, Undetermined):
            self._undetermined[camera] = result.reasons
            return False
        self._undetermined.pop(camera, None)
        self._located[camera] = result
        for index, readings in result.readings.items():
            entry = self.data.entries[index]
            entry.observation = entry.observation.read_as(readings)
        return True

    def _forget(self, camera: str, reason: str) -> None:
        self._located.pop(camera, None)
        self._undetermined[camera] = (reason,)
        for index in self._entries_of(camera):
            entry = self.data.entries[index]
            entry.observation = entry.observation.judged(Verdict.PENDING)

    def _drop_misplaced(self, camera: str) -> None:
        """A camera most of whose sightings contradict its place loses it, and starts anew."""
        if camera in self.data.known.poses:
            return
        entries = self.data.of_camera(camera)
        rejected = sum(entry.observation.verdict is Verdict.REJECTED for entry in entries)
        if len(entries) < _LEAST_TO_DROP or rejected * 2 <= len(entries):
            return
        self._forget(camera, "its pictures contradict each other")
        self._tries[camera] = len(entries)
        self.solve()
        if self._belief is not None:
            self._waiting[camera] = (len(self._steps), self._belief)

    def _state(self) -> State:
        """What is believed, as `locate` takes it."""
        assert self._belief is not None
        first = self.data.first_state()
        cameras = {name: self._belief.camera(name) for name in self._belief.cameras}
        robots = {
            name: replace(robot, scales=self._belief.scales(name))
            for name, robot in first.robots.items()
        }
        return State(cameras, robots)

    # -- all of it anew ---------------------------------------------------------------------------

    def solve(self) -> None:
        """Go through everything from the beginning, in order of time."""
        if self._belief is None:
            return
        self.iterations += 1
        known = set(self._located) | set(self.data.known.poses)
        chosen = [i for i, e in enumerate(self.data.entries) if e.observation.camera in known]
        order = sorted(chosen, key=lambda i: (self._time_ns(i), i))
        self._belief, self._steps, self._waiting = self._origin(self.data), [], {}
        for index in order:
            self._apply(index)

    def finish(self) -> None:
        """Locate every camera that can be located, and take every sighting that came too late."""
        for _ in range(len(self.data.site.cameras) + 1):
            if self._belief is None:
                return
            missing = [
                name
                for name in self.data.site.cameras
                if not self._is_located(name) and self.data.of_camera(name)
            ]
            found = [name for name in missing if self._locate(name)]
            if found or not self._is_complete():
                self.solve()
            for name in found:
                if name not in self._belief.cameras:
                    self._forget(name, _LOOSE)
            if not found:
                return

    def _is_complete(self) -> bool:
        """Whether every sighting of a located camera was gone through."""
        mine = sum(self._is_located(e.observation.camera) for e in self.data.entries)
        return mine == len(self._steps)

    # -- output -----------------------------------------------------------------------------------

    def robot(self, robot: str) -> RobotEstimate | None:
        if self._belief is None or robot not in self._belief.stamps_ns:
            return None
        known = self._carried.get(robot)
        is_fresh = known is not None and known[0] is self._belief
        estimate = known[1] if known is not None and is_fresh else self._belief.robot(robot)
        last_ns = self.data.tracks[robot].last_ns
        estimate = carried_on(self.data, robot, estimate, last_ns, self._belief.scales(robot))
        self._carried[robot] = (self._belief, estimate)
        return estimate

    def particles(self, robot: str) -> Pose | None:
        """Places where the robot may be at its last odometry message, all equally likely."""
        if self._belief is None or robot not in self._belief.stamps_ns:
            return None
        return self._belief.advanced(self.data, robot, self.data.tracks[robot].last_ns).particles(
            robot
        )

    def _placed(self) -> list[str]:
        """The located cameras that are tied to the map, in the site's order."""
        if self._belief is None:
            return []
        here = [name for name in self.data.site.cameras if name in self._belief.cameras]
        return [name for name in here if is_placed(self._belief.estimate(name).covariance)]

    def cameras(self) -> dict[str, CameraEstimate]:
        if self._belief is None:
            return {}
        return {name: self._belief.estimate(name) for name in self._placed()}

    @property
    def located_count(self) -> int:
        return len(self._belief.cameras) if self._belief is not None else 0

    def joint_covariance(self) -> Array:
        placed = self._placed()
        if self._belief is None or not placed:
            return np.zeros((0, 0))
        return self._belief.joint_covariance(placed)

    def undetermined(self) -> dict[str, tuple[str, ...]]:
        placed = set(self._placed())
        return {
            name: self._undetermined.get(name, ("too few pictures of the robot so far",))
            for name in self.data.site.cameras
            if name not in placed and self.data.of_camera(name)
        }

    def count(self, camera: str) -> CameraCount:
        entries = self.data.of_camera(camera)
        sightings = sum(len(entry.observation.views) for entry in entries)
        used = sum(entry.observation.used_views for entry in entries)
        rejected = sightings - used if self._is_located(camera) else 0
        squares = [
            step.surprise.rms_px**2
            for step in self._steps
            if step.surprise is not None
            and self.data.entries[step.entry].observation.camera == camera
        ]
        rms = float(np.sqrt(np.mean(squares))) if squares else None
        return CameraCount(sightings, rejected, rms)

    def trajectory(self, robot: str) -> Trajectory | None:
        track = self.data.tracks[robot]
        nodes = nodes_of(self.data, self._steps, robot)
        if not nodes or self._belief is None:
            return None
        poses = poses_at(self.data, self._belief, robot, nodes, track.stamps_ns)
        return Trajectory(track.stamps_ns.copy(), poses)

    def _place(self, indices: list[int]) -> None:
        """Put where the robots stood, as far as it is known now, into entries of the data set."""
        for robot, track in self.data.tracks.items():
            mine = [self.data.entries[i] for i in indices]
            mine = [entry for entry in mine if entry.observation.robot == robot]
            if not mine:
                continue
            nodes = nodes_of(self.data, self._steps, robot)
            stamps = np.array([entry.observation.stamp_ns for entry in mine])
            moments = np.clip(stamps, track.first_ns, track.last_ns)
            poses = None
            if nodes and self._belief is not None:
                poses = poses_at(self.data, self._belief, robot, nodes, moments)
            for row, entry in enumerate(mine):
                entry.map_from_base = poses[row] if poses is not None else None

    def scales(self, robot: str) -> Array:
        return self._belief.scales(robot) if self._belief is not None else np.zeros(2)

    def base_from_faces(self, robot: str) -> Pose:
        return base_from_faces(self.data.targets[robot])

    @property
    def chi2_per_dof(self) -> float | None:
        used = [step.surprise for step in self._steps if step.surprise is not None]
        freedom = sum(surprise.total_freedom for surprise in used)
        return sum(surprise.total for surprise in used) / freedom if freedom > 0 else None
