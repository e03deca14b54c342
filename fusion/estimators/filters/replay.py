"""A filter's pass through its sightings, in order of time.

Filter states are immutable: for a late sighting the filter goes back to the state before it and
processes what followed again, as far as the last 64 sightings reach; an older one is used when the
session is finished. A camera that is located goes back to its first sighting likewise.
"""

import bisect
from collections.abc import Callable, Iterable
from copy import copy
from dataclasses import replace

import numpy as np

from trigpoint.clock import to_ns
from trigpoint.fusion.initialisation.cameras import Located
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.observations import Verdict
from trigpoint.fusion.model.problem import State
from trigpoint.fusion.solver.filter import RobotEstimate, is_placed

from .filter_state import FilterState, Innovation
from .history import Step
from .sighting_update import first_sighting, is_expected, predicted_at, read_sighting

_HISTORY = 64
# A camera's pictures wait for it to be located while so many others are used.
_MOST_REPLAYED = 256
# So many sightings in a row by two cameras or more that contradict where the robot is believed to
# be: it was carried.
_CARRIED = 4


class Replay:
    """`filter_state`: after all of the `steps`; `located`: cameras, by all of their sightings."""

    def __init__(self, data: DataSet, origin: Callable[[DataSet], FilterState]) -> None:
        self._data, self._origin = data, origin
        self.filter_state = origin(data)
        self.steps: list[Step] = []
        self.located: dict[str, Located] = {}
        # The step before which each camera that is not located was first seen, and the filter state
        # then.
        self._first_seen: dict[str, tuple[int, FilterState]] = {}

    def copy(self) -> "Replay":
        """A copy, to continue from if the next observation is unusable."""
        other = copy(self)
        other.steps, other.located = list(self.steps), dict(self.located)
        other._first_seen = dict(self._first_seen)
        return other

    def is_located(self, camera: str) -> bool:
        return camera in self.located or camera in self._data.known.poses

    def state(self) -> State:
        """The estimate in the form that `initialisation.cameras.locate` takes."""
        first, filter_state = self._data.first_state(), self.filter_state
        cameras = {name: filter_state.camera(name) for name in filter_state.cameras}
        robots = {
            name: replace(robot, scales=filter_state.scales(name))
            for name, robot in first.robots.items()
        }
        return State(cameras, robots)

    # -- which sighting comes next ----------------------------------------------------------------

    def insert(self, index: int) -> RobotEstimate | None:
        """Use a sighting at its place in time; None where it makes no correction."""
        place = bisect.bisect_right(self.steps, self._time_ns(index), key=lambda s: s.time_ns)
        later = self._rewind(place)
        if later is None:
            return None  # older than the history
        correction = self._take(index)
        for step in later:
            self._take(step.entry)
        return correction

    def wait(self, camera: str) -> None:
        """Remember when a camera that is not located was first seen."""
        first = self._first_seen.get(camera)
        if first is None or len(self.steps) - first[0] > _MOST_REPLAYED:
            self._first_seen[camera] = (len(self.steps), self.filter_state)

    def enter(self, camera: str, indices: Iterable[int]) -> bool:
        """Go back to where a located camera was first seen and process its sightings too; whether
        the camera is part of the filter state then."""
        first = self._first_seen.pop(camera)
        later = [step.entry for step in self._back_to(*first)]
        since_ns = self.steps[-1].time_ns if self.steps else 0
        self._take_all([*later, *(i for i in indices if self._time_ns(i) >= since_ns)])
        if camera in self.filter_state.cameras:
            return True
        self._first_seen[camera] = first
        return False

    def restart(self) -> None:
        """Process every sighting of the located cameras again, from the beginning."""
        chosen = self._usable()
        self.filter_state, self.steps, self._first_seen = self._origin(self._data), [], {}
        self._take_all(chosen)

    def is_complete(self) -> bool:
        """Whether every sighting of a located camera was processed."""
        return len(self._usable()) == len(self.steps)

    def _usable(self) -> list[int]:
        entries = self._data.entries
        return [i for i, e in enumerate(entries) if self.is_located(e.observation.camera)]

    def _take_all(self, indices: list[int]) -> None:
        for _, index in sorted((self._time_ns(i), i) for i in indices):
            self._take(index)

    def _time_ns(self, index: int) -> int:
        """When the robot stood as it was seen: stamp minus the camera's time offset."""
        observation, offset_s = self._data.entries[index].observation, 0.0
        if observation.camera in self.filter_state.cameras:
            offset_s = self.filter_state.camera(observation.camera).time_offset_s
        track = self._data.tracks[observation.robot]
        return int(np.clip(observation.stamp_ns - to_ns(offset_s), track.first_ns, track.last_ns))

    def _rewind(self, place: int) -> list[Step] | None:
        """Go back before a step; the steps to process again, None where that is too long ago."""
        if place == len(self.steps):
            return []
        before = self.steps[place].before
        return None if before is None else self._back_to(place, before)

    def _back_to(self, place: int, filter_state: FilterState) -> list[Step]:
        later, self.steps = self.steps[place:], self.steps[:place]
        self.filter_state = filter_state
        for camera, (first, _) in self._first_seen.items():
            if first > place:
                self._first_seen[camera] = (place, filter_state)
        return later

    # -- one sighting -----------------------------------------------------------------------------

    def _take(self, index: int) -> RobotEstimate | None:
        """Process one sighting; the robot's pose then, None where it makes no correction."""
        before, entry = self.filter_state, self._data.entries[index]
        robot, camera = entry.observation.robot, entry.observation.camera
        time_ns = max(self._time_ns(index), before.stamps_ns.get(robot, 0))
        is_new = camera not in before.cameras
        after = (self._begun if is_new else self._used)(before, index, time_ns)
        step = Step(time_ns, index, before, None, None)
        self.steps.append(step)
        if len(self.steps) > _HISTORY:
            self.steps[-_HISTORY - 1].before = None
        if after is None:
            verdict = Verdict.REJECTED if self._is_used(before, index) else Verdict.PENDING
            entry.observation = entry.observation.judged(verdict)
            self.filter_state = self._unless_carried(before, robot)
            return None
        self.filter_state, step.innovation = after
        estimate = self.filter_state.robot(robot)
        entry.observation = entry.observation.judged(Verdict.ACCEPTED)
        entry.map_from_base = step.map_from_base = estimate.map_from_base
        return estimate if not is_new and is_placed(estimate.covariance) else None

    def _is_used(self, filter_state: FilterState, index: int) -> bool:
        """Whether a sighting could have been used: one before its camera's first sighting, or while
        the robot's pose is unknown, carries no information yet."""
        observation = self._data.entries[index].observation
        if observation.camera in filter_state.cameras:
            return True
        read = self.located[observation.camera].readings
        robots = {self._data.entries[i].observation.robot for i in read}
        return observation.robot in robots and observation.robot in filter_state.stamps_ns

    def _used(
        self, before: FilterState, index: int, time_ns: int
    ) -> tuple[FilterState, Innovation] | None:
        """The state updated by a sighting of one of its cameras, where it does not contradict
        it."""
        entry = self._data.entries[index]
        filter_state, predicted = predicted_at(self._data, before, entry.observation.robot, time_ns)
        if predicted is not None:
            entry.map_from_base = predicted.map_from_base
        scales = filter_state.scales(entry.observation.robot)
        entry.observation = self._data.moving(entry.observation, time_ns, scales)
        sighting = read_sighting(self._data, filter_state, entry.observation, predicted)
        if sighting is None:
            return None
        entry.observation = sighting.observation
        updated = filter_state.updated(self._data, sighting)
        if updated is None or not is_expected(updated[1]):
            return None
        return updated

    def _begun(
        self, before: FilterState, index: int, time_ns: int
    ) -> tuple[FilterState, Innovation] | None:
        """With the first sighting of a camera that was located by all of its sightings."""
        entry = self._data.entries[index]
        observation = entry.observation
        found = self.located[observation.camera]
        filter_state, predicted = predicted_at(self._data, before, observation.robot, time_ns)
        if predicted is None or index not in found.map_from_base or observation.chosen is None:
            return None
        sighting = first_sighting(self._data, observation, found, found.map_from_base[index])
        if sighting is None:
            return None
        entry.observation = sighting.observation
        return filter_state.with_camera(self._data, sighting, found.camera)

    def _unless_carried(self, filter_state: FilterState, robot: str) -> FilterState:
        """Without the robot, where its last sightings say that it is somewhere else."""
        cameras: list[str] = []
        for step in reversed(self.steps[-_HISTORY:]):
            observation = self._data.entries[step.entry].observation
            if observation.robot == robot:
                if step.innovation is not None:
                    break
                cameras.append(observation.camera)
        if len(cameras) < _CARRIED or len(set(cameras)) < 2 or robot not in filter_state.stamps_ns:
            return filter_state
        return filter_state.without_robot(robot)
