"""Finds the modes of each visit: searches from many starts and keeps the modes near the best."""

import math
from collections.abc import Iterable

import numpy as np
from msgspec.structs import replace

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.drift import Drift
from trigpoint.fusion.model.observations import Observation, Reading
from trigpoint.fusion.model.problem import CameraState
from trigpoint.fusion.model.trajectory import odometry_poses
from trigpoint.fusion.reading.faces import are_same_pose
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from .consensus import MOST_SEEDS, Start, drift_between, starts_of
from .events import Events, window
from .local import LocalProblem
from .memory import Memory
from .mode import Mode, VisitModes
from .pictures import PictureReader
from .sightings import Alone, by_itself, tamed
from .visits import Visit

# A mode that is worse than the best of its visit by this can only be right if other visits give
# evidence for it that is as strong.
_WINDOW = 2 * window()
# A standing robot with six equal faces has six modes, and several starts lead to each.
_MOST_STARTS = 24
_MOST_SPLITS = 3
_MORE_WRONG = 2


class ModeFinder:
    """Finds the modes of visits over one session's observations.

    Single sightings are judged, and searches start, with the `lenses` learnt from other visits; the
    priors of estimated lenses remain the data set's.
    """

    def __init__(
        self,
        data: DataSet,
        observations: list[Observation],
        events: Events,
        memory: Memory | None = None,
    ) -> None:
        self.data, self.observations, self.events = data, observations, events
        self.memory = memory if memory is not None else Memory()
        self.lenses = data.lenses | self.memory.lenses
        self._alone: dict[int, tuple[Alone, ...]] = {}
        self._tame: dict[int, Observation] = {}

    def alone(self, index: int) -> tuple[Alone, ...]:
        """What each view of an observation says by itself."""
        if index not in self._alone:
            views = range(len(self.observations[index].views))
            self._alone[index] = tuple(self._by_itself(index, order) for order in views)
        return self._alone[index]

    def tame(self, index: int) -> Observation:
        """An observation without its wild corners, from which starts are computed."""
        if index not in self._tame:
            self._tame[index] = tamed(self.observations[index], self.alone(index))
        return self._tame[index]

    def _by_itself(self, index: int, order: int) -> Alone:
        observation = self.observations[index]
        target, lens = self.data.targets[observation.robot], self.lenses[observation.camera]
        key = observation.views[order], lens
        if key not in self.memory.alone:
            self.memory.budget.spend_looking()
            self.memory.alone[key] = by_itself(*key, target, self.events)
        return self.memory.alone[key]

    def parts_of(self, visit: Visit, *, most: int = _MOST_SPLITS) -> list[VisitModes]:
        """The modes of a visit. Where an end of it contradicts the rest, an event may lie between
        them: several sightings are a visit of their own, split off; a single one is likelier wrong,
        and the visit begins after it or ends before it. `most`: how often may be split."""
        whole = self.modes_of(visit)
        right = self._right(whole) if most else None
        if right is None:
            return [whole]
        start, end = right
        cut = start if self._sightings(visit.indices[:start]) > 1 else end
        other = visit.indices[:start] if cut == start else visit.indices[end:]
        if self._sightings(other) > 1 or not whole.modes:
            parts = visit.part(self.observations, 0, cut), visit.part(self.observations, cut, None)
        elif self._sightings(visit.indices[start:end]) > 1 and self._all_wrong(whole, other):
            parts = (visit.within(self.observations, start, end),)
        else:  # which of them is wrong, other visits tell
            return [whole]
        return [each for part in parts for each in self.parts_of(part, most=most - 1)]

    def _right(self, found: VisitModes) -> tuple[int, int] | None:
        """Between which of a visit's pictures the first and the last lie that do not contradict its
        best mode; None where its chosen ones begin and end with such. Where nothing fits, the first
        half: a part may be right."""
        indices, chosen = found.visit.indices, found.visit.chosen
        if not found.modes:
            is_whole = (chosen[0], chosen[-1]) == (indices[0], indices[-1]) and len(indices) > 1
            return (0, (len(indices) + 1) // 2) if is_whole else None
        readings = found.modes[0].readings
        if not (_is_wrong(readings[chosen[0]]) or _is_wrong(readings[chosen[-1]])):
            return None
        self.memory.budget.spend_completing(pictures=len(indices) - len(chosen))
        readings = self.completed(found.visit, found.modes[0]).readings
        right = [order for order, index in enumerate(indices) if not _is_wrong(readings[index])]
        return right[0], right[-1] + 1

    def _all_wrong(self, found: VisitModes, indices: Iterable[int]) -> bool:
        """Whether every mode that chose among these pictures takes them as wrong."""
        return all(_is_wrong(mode.readings.get(i, ())) for mode in found.modes for i in indices)

    def _sightings(self, indices: Iterable[int]) -> int:
        return sum(len(self.observations[index].views) for index in indices)

    def modes_of(self, visit: Visit) -> VisitModes:
        """All modes of a visit within the window; if not cached, none once the budget is spent."""
        key = self.key(visit)
        found = self.memory.modes.get(key)
        if found is None and self.memory.budget.is_spent:
            return VisitModes(visit, (), 0.0, ())
        if found is None:
            found = self._modes_of(visit)
            self.memory.modes.put(key, found)
        return found if found.visit == visit else renumbered(found, visit)

    def key(self, visit: Visit) -> tuple[object, ...]:
        """The cache key of a visit: what its modes depend on, and nothing else of the session."""
        track = self.data.tracks[visit.robot]
        jitter = self.data.jitter.get(visit.robot)
        chosen = [self.observations[index] for index in visit.chosen]
        seen = tuple((each.stamp_ns, each.views) for each in chosen)
        noise = track.noise, track.scales, track.slip, track.skid, jitter
        lenses = self.data.lenses[visit.camera], self.lenses[visit.camera]
        return visit.camera, visit.robot, seen, noise, lenses

    def _modes_of(self, visit: Visit) -> VisitModes:
        chosen = {index: self.observations[index] for index in visit.chosen}
        poses = self.odometry(visit)
        scores = {index: tuple(a.wrong_score for a in self.alone(index)) for index in chosen}
        budget = self.memory.budget
        problem = LocalProblem(self.data, chosen, poses, scores, self.events, budget)
        found = self._found(visit, problem, self._starts(visit, poses))
        near = self._plausible(visit, found)
        right = [i for i in chosen if not any(_is_wrong(mode.readings[i]) for mode in near)]
        moments = tuple((chosen[index].stamp_ns, index) for index in right)
        nothing = sum(sum(row) for row in scores.values())
        if len(chosen) == 1 and near:  # its faces may be wrong together: taken at another time, say
            nothing = min(nothing, near[0].evidence + self.events.wrong_limit)
        return VisitModes(visit, near, nothing, moments)

    def _found(self, visit: Visit, problem: LocalProblem, starts: list[Start]) -> list[Mode]:
        lens, found, most = self.lenses[visit.camera], list[Mode](), None
        for start in starts:
            mode = problem.mode_near(CameraState(start.map_from_camera, lens), start.wrong, most)
            if mode is not None:
                found.append(mode)
                # A mode with some more wrong sightings is far outside the window.
                own = mode.wrong + _MORE_WRONG
                most = own if most is None else min(most, own)
        return distinct(found + self._unmasked(problem, distinct(found)))

    def _unmasked(self, problem: LocalProblem, found: list[Mode]) -> list[Mode]:
        """More modes near the best ones, each with another of the `likeliest_wrong` sets."""
        others = []
        known = {problem.wrong_by(mode).tobytes() for mode in found}
        for mode in found:
            if mode.evidence > found[0].evidence + window():
                break
            for wrong in problem.likeliest_wrong(mode):
                if wrong.tobytes() in known:
                    continue
                known.add(wrong.tobytes())
                other = problem.mode_near(mode.camera, wrong)
                if other is not None:
                    others.append(other)
        return others

    def completed(self, visit: Visit, mode: Mode) -> Mode:
        """Extend a mode from the chosen pictures of its visit to all: each of the others is read,
        and judged right or wrong, by itself, at the robot's pose by odometry from the nearest
        chosen one."""
        if len(visit.chosen) == len(visit.indices):
            return mode
        poses, drifts = self._between(visit, mode)
        rows = np.flatnonzero([index not in mode.readings for index in visit.indices])
        others = [visit.indices[row] for row in rows]
        reader = PictureReader(self.data, visit.robot, mode.camera, self.events, mode.faces)
        read = reader.read([self.observations[i] for i in others], poses[rows], drifts[rows])
        readings, wild = dict(mode.readings), dict(mode.wild)
        for index, (mine, flags) in zip(others, read, strict=True):
            readings[index], wild[index] = mine, flags
        stood = {index: poses[row] for row, index in zip(rows.tolist(), others, strict=True)}
        return replace(mode, readings=readings, wild=wild, poses=stood | mode.poses)

    def _between(self, visit: Visit, mode: Mode) -> tuple[Pose, Array]:
        """The robot's poses at all pictures (n) by odometry from the nearest chosen one, and the
        covariances (n, 6, 6) of that odometry."""
        track = self.data.tracks[visit.robot]
        stamps = np.array([self.observations[index].stamp_ns for index in visit.indices])
        taken = self.data.true_times_ns(mode.camera, stamps)
        inside = np.clip(taken, track.first_ns, track.last_ns)
        odometry = odometry_poses(track, inside)
        moments, row_of = np.unique(inside, return_inverse=True)
        anchors = np.array([row for row, i in enumerate(visit.indices) if i in mode.poses])
        near = anchors[np.argmin(np.abs(stamps[anchors] - stamps[:, None]), axis=1)]
        start = Pose.stack([mode.poses[visit.indices[row]] for row in near.tolist()])
        poses = start @ (odometry[near].inverse() @ odometry)
        at = np.unique(row_of, return_index=True)[1]
        drift = Drift.of(track, moments, np.zeros(2), poses[at])
        return poses, drift.between(row_of[near], row_of)[0]

    def odometry(self, visit: Visit) -> dict[int, Pose]:
        """Where odometry puts the robot at each chosen picture."""
        track = self.data.tracks[visit.robot]
        stamps = [self.observations[index].stamp_ns for index in visit.chosen]
        moments = np.clip(np.array(stamps), track.first_ns, track.last_ns)
        poses = odometry_poses(track, moments)
        return {index: poses[i] for i, index in enumerate(visit.chosen)}

    def _starts(self, visit: Visit, poses: dict[int, Pose]) -> list[Start]:
        tame = {index: self.tame(index) for index in visit.chosen}
        stamps = np.array([observation.stamp_ns for observation in tame.values()])
        there = Pose.stack(list(poses.values()))
        drift = drift_between(self.data, visit.robot, stamps, there)
        sizes = [len(view.readings) for seen in tame.values() for view in seen.views]
        seeds = math.ceil(sum(sizes) * min(1, MOST_SEEDS / len(sizes)))
        self.memory.budget.spend_starting(ways=sum(sizes), seeds=seeds)
        known = replace(self.data, lenses=self.lenses)
        return starts_of(known, tame, poses, drift, self.events, most=_MOST_STARTS, window=_WINDOW)

    def _plausible(self, visit: Visit, found: list[Mode]) -> tuple[Mode, ...]:
        """The modes within the window; where one above the floor that the robot drives on fits
        about as well as the best, without those surely below it (decisions/0611)."""
        best = min((mode.evidence for mode in found), default=np.inf)
        near = [mode for mode in found if mode.evidence < best + _WINDOW]
        if self.data.tracks[visit.robot].planar:
            above = [mode for mode in near if not mode.is_below(window())]
            if above and above[0].evidence < best + window():
                near = above
        return tuple(near)


def renumbered(found: VisitModes, visit: Visit) -> VisitModes:
    """What was found of the same pictures under other indices, with those of `visit`."""
    number = dict(zip(found.visit.chosen, visit.chosen, strict=True))
    modes = [
        replace(
            mode,
            readings={number[index]: row for index, row in mode.readings.items()},
            wild={number[index]: row for index, row in mode.wild.items()},
            poses={number[index]: pose for index, pose in mode.poses.items()},
        )
        for mode in found.modes
    ]
    right = tuple((stamp_ns, number[index]) for stamp_ns, index in found.right)
    return VisitModes(visit, tuple(modes), found.nothing, right)


def _is_wrong(readings: tuple[Reading | None, ...]) -> bool:
    return all(reading is None for reading in readings)


def distinct(found: Iterable[Mode]) -> list[Mode]:
    """The modes that differ in the camera's pose or in their readings, best first."""
    every = sorted(found, key=lambda mode: mode.evidence)
    poses, kept = Pose.stack([mode.map_from_camera for mode in every]), list[int]()
    one = Pose(poses.rotation[:, None], poses.translation[:, None])
    alike = are_same_pose(one, poses).tolist()
    for row, mode in enumerate(every):
        if not any(alike[row][other] and every[other].readings == mode.readings for other in kept):
            kept.append(row)
    return [every[row] for row in kept]
