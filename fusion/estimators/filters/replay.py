"""A filter's pass through its sightings, in order of time.

Filter states are immutable: for a late sighting the filter goes back to the state before it and
processes what followed again, as far as the last 64 sightings reach; an older one is used once
everything is explained anew.
"""

import bisect
from collections import defaultdict
from collections.abc import Callable, Mapping

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.linalg import LinAlgError

from trigpoint.base.clock import to_ns
from trigpoint.fusion.estimators.robot_alignment import align_to
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.gates import is_noise
from trigpoint.fusion.model.observations import Observation, Verdict
from trigpoint.fusion.model.problem import CameraState
from trigpoint.fusion.solver.filter import RobotEstimate, is_placed
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from .filter_state import FilterState, Innovation, ReadSighting
from .relative_pose import without_wild_corners

_HISTORY = 64
# With one wrong reading in twenty, so many in a row occur once in 160,000 times.
_IN_A_ROW = 4


class Step(Struct):
    """The outcome of one sighting. `before`: the filter state before it, None where that is too
    long ago; `map_from_base`: afterwards; `innovation`: None where it was set aside."""

    time_ns: int
    entry: int
    before: FilterState | None
    map_from_base: Pose | None
    innovation: Innovation | None


class Contradiction(Struct, frozen=True):
    """Consecutive sightings by one camera or of one robot, `what`, all of which contradict the
    filter state, which noise or a single wrong reading does not explain."""

    what: str
    since_ns: int
    until_ns: int

    @property
    def text(self) -> str:
        """The report to the user."""
        return (
            f"{_IN_A_ROW} pictures or more in a row {self.what} contradict the rest: a robot was "
            "carried, a camera was moved, or the filter went wrong and with it the cameras that it "
            'located meanwhile; run the session with estimator = "smoother"'
        )


class Replay:
    """A filter and its steps so far. `has_begun`: whether the odometry that fixes the map has;
    `filter_state`: after all of the `steps`; `located`: the approximate states of cameras, by all
    of their sightings; `left_open`: by camera, the covariance (6, 6) of what explanations leave
    open of its pose, which the state has in it."""

    def __init__(self, data: DataSet, origin: Callable[[DataSet], FilterState]) -> None:
        self._data, self._origin = data, origin
        self.filter_state, self.has_begun = origin(data), False
        self.steps: list[Step] = []
        self.located: Mapping[str, CameraState] = {}
        self.left_open: Mapping[str, Array] = {}
        self._spread_after = 0
        # By entry, where several pictures share a tilt: see `Jitter.among`.
        self._variances: dict[int, Array] = {}

    def begin(self, robot: str) -> None:
        """Note a robot's odometry."""
        if not self.has_begun and (robot == self._data.anchored_robot or self._data.known.poses):
            self.filter_state, self.has_begun = self._origin(self._data), True

    def is_located(self, camera: str) -> bool:
        return camera in self.located or camera in self._data.known.poses

    # -- which sighting comes next ----------------------------------------------------------------

    def insert(self, index: int) -> RobotEstimate | None:
        """Use a sighting at its place in time; None where it makes no correction. Where it is
        numerically unusable, everything is as before it, and LinAlgError or ValueError raised."""
        if not self.is_located(self._data.entries[index].observation.camera):
            return None
        place = bisect.bisect_right(self.steps, self._time_ns(index), key=lambda s: s.time_ns)
        if place < len(self.steps) and self.steps[place].before is None:
            return None  # older than the history
        before = self.filter_state, list(self.steps), self._spread_after
        try:
            later = self._back_to(place)
            correction = self._take(index)
            for step in later:
                self._take(step.entry)
            if place < self._spread_after:  # the states before it are without
                self._spread()
        except (LinAlgError, ValueError):
            self.filter_state, self.steps, self._spread_after = before
            raise
        return correction

    def restart(self, located: Mapping[str, CameraState], left_open: Mapping[str, Array]) -> None:
        """Process all accepted observations from the beginning; `located`, `left_open`: as in the
        class."""
        self.filter_state, self.steps = self._origin(self._data), []
        self.located, self.left_open = located, left_open
        accepted = [
            index
            for index, entry in enumerate(self._data.entries)
            if entry.observation.verdict is Verdict.ACCEPTED
        ]
        self._variances = _shared_variances(self._data, accepted)
        for _, index in sorted((self._time_ns(index), index) for index in accepted):
            self._take(index)
        self._spread()

    def _spread(self) -> None:
        """Add to the state, after the steps so far, what is left open of its cameras' poses."""
        here = {n: each for n, each in self.left_open.items() if n in self.filter_state.cameras}
        self.filter_state, self._spread_after = self.filter_state.spread(here), len(self.steps)

    def _time_ns(self, index: int) -> int:
        """The true time at which the robot was seen: stamp minus the camera's time offset."""
        observation, offset_s = self._data.entries[index].observation, 0.0
        if observation.camera in self.filter_state.cameras:
            offset_s = self.filter_state.camera(observation.camera).time_offset_s
        track = self._data.tracks[observation.robot]
        return int(np.clip(observation.stamp_ns - to_ns(offset_s), track.first_ns, track.last_ns))

    def _back_to(self, place: int) -> list[Step]:
        """Go back to before a step; return the steps to process again."""
        later, self.steps = self.steps[place:], self.steps[:place]
        if later:
            assert later[0].before is not None
            self.filter_state = later[0].before
        return later

    # -- one sighting -----------------------------------------------------------------------------

    def _take(self, index: int) -> RobotEstimate | None:
        """Process one sighting; return the robot's pose, None where it makes no correction."""
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
            verdict = Verdict.PENDING if is_new else Verdict.REJECTED
            entry.observation = entry.observation.judged(verdict)
            return None
        self.filter_state, step.innovation = after
        estimate = self.filter_state.robot(robot)
        entry.observation = entry.observation.judged(Verdict.ACCEPTED)
        entry.map_from_base = step.map_from_base = estimate.map_from_base
        return estimate if not is_new and is_placed(estimate.covariance) else None

    def _used(
        self, before: FilterState, index: int, time_ns: int
    ) -> tuple[FilterState, Innovation] | None:
        """The state updated by a sighting of one of its cameras, where it does not contradict
        it."""
        entry = self._data.entries[index]
        filter_state, predicted = self._predicted(before, entry.observation.robot, time_ns)
        scales = filter_state.scales(entry.observation.robot)
        observation = self._data.moving(entry.observation, time_ns, scales)
        sighting = self._read(filter_state, _as_read(observation), predicted, index)
        if sighting is None:
            return None
        if observation.chosen is None:
            entry.observation = sighting.observation
        updated = filter_state.updated(self._data, sighting)
        return updated if updated is not None and updated[1].is_expected else None

    def _predicted(
        self, before: FilterState, robot: str, time_ns: int
    ) -> tuple[FilterState, RobotEstimate | None]:
        """The state at a later time, and the robot there; None where its pose is not known."""
        if robot not in before.stamps_ns:
            return before, None
        filter_state = before.advanced(self._data, robot, time_ns)
        predicted = filter_state.robot(robot)
        if not is_placed(predicted.covariance):
            return before.without_robot(robot), None
        return filter_state, predicted

    def _read(
        self, state: FilterState, seen: Observation, predicted: RobotEstimate | None, index: int
    ) -> ReadSighting | None:
        """An entry in its best reading; None where that is ambiguous or nothing fits."""
        camera = state.estimate(seen.camera)
        lens, map_from_camera = camera.lens, camera.map_from_camera
        found = align_to(self._data, seen, lens, map_from_camera, camera.covariance, predicted)
        if found is None:
            return None
        pose = map_from_camera.inverse() @ found.map_from_base
        sound = without_wild_corners(found.read(seen), self._data.targets[seen.robot], lens, pose)
        if sound is None:
            return None
        variances = self._disturbance(index)
        return ReadSighting(sound, found.map_from_base, variances, places_robot=predicted is None)

    def _begun(
        self, before: FilterState, index: int, time_ns: int
    ) -> tuple[FilterState, Innovation] | None:
        """The state with a camera that all of its sightings located, added by its first one, where
        that does not contradict them."""
        entry = self._data.entries[index]
        observation, stood = _as_read(entry.observation), entry.map_from_base
        filter_state, predicted = self._predicted(before, observation.robot, time_ns)
        if predicted is None or stood is None or observation.chosen is None:
            return None
        camera, target = self.located[observation.camera], self._data.targets[observation.robot]
        pose, variances = camera.map_from_camera.inverse() @ stood, self._disturbance(index)
        sound = without_wild_corners(observation, target, camera.lens, pose)
        if sound is None:
            return None
        sighting = ReadSighting(sound, stood, variances)
        view = sighting.view(self._data, camera.lens, pose)
        if view is None or not is_noise(float(view.residual @ view.residual), len(view.residual)):
            return None
        return filter_state.with_camera(self._data, sighting, camera)

    def _disturbance(self, index: int) -> Array | None:
        """The variances (6,) of the robot's deviation in one picture; None where there is none."""
        jitter = self._data.jitter.get(self._data.entries[index].observation.robot)
        return None if jitter is None else self._variances.get(index, jitter.variances)


def _shared_variances(data: DataSet, indices: list[int]) -> dict[int, Array]:
    """For each of these entries the variances (6,) of its robot's deviation in its picture, given
    the other pictures in which the same camera saw it."""
    together = defaultdict[tuple[str, str], list[int]](list)
    for index in indices:
        observation = data.entries[index].observation
        if observation.robot in data.jitter and data.entries[index].map_from_base is not None:
            together[observation.camera, observation.robot].append(index)
    found: dict[int, Array] = {}
    for (_, robot), mine in together.items():
        stood = Pose.stack([pose for i in mine if (pose := data.entries[i].map_from_base)])
        found |= zip(mine, data.jitter[robot].among(stood.translation), strict=True)
    return found


def _as_read(observation: Observation) -> Observation:
    """An observation reduced to its correct views, each with the one reading that was chosen."""
    if observation.chosen is None:
        return observation
    every = zip(observation.views, observation.chosen, observation.wild, strict=True)
    right = [
        (replace(view, readings=(reading,)), reading)
        for view, reading, wild in every
        if not np.all(wild)
    ]
    views, chosen = zip(*right, strict=True)
    return replace(observation, views=views, chosen=chosen, outliers=())


def contradictions(data: DataSet, steps: list[Step]) -> list[Contradiction]:
    """The contradictions among the steps, in order of their ends."""
    found: list[Contradiction] = []
    runs: dict[str, list[int]] = {}
    for step in steps:
        observation = data.entries[step.entry].observation
        for what in (f"by camera {observation.camera}", f"of robot {observation.robot}"):
            if observation.verdict is Verdict.REJECTED:
                runs.setdefault(what, []).append(observation.stamp_ns)
            elif what in runs:
                found += _told({what: runs.pop(what)})
    return found + _told(runs)


def _told(runs: dict[str, list[int]]) -> list[Contradiction]:
    return [
        Contradiction(what, stamps_ns[0], stamps_ns[-1])
        for what, stamps_ns in runs.items()
        if len(stamps_ns) >= _IN_A_ROW
    ]
