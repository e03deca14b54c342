"""What befell a site whose sightings contradict each other: when a robot was lifted, when a camera
was moved.

A robot that is lifted shows nothing of it at once; it meets cameras that have not seen it before,
and contradicts the rest only when it comes back to one that has. So every moment at which it may
have happened is tried: a lift in the gaps between two visits, a move between two visits to the
camera. Each is worked out from the beginning, over a few sightings of each visit, and χ² decides.
Where several explain everything alike, it cannot be known which it was, and all of them are taken
to have happened: what is located then is what holds by each of them.
"""

from dataclasses import dataclass, replace

import numpy as np

from .batch import BatchSolution
from .contradictions import is_denied
from .dataset import DataSet, Knock, KnownCameras, Lift, Move, Upheaval
from .filter import Filter
from .observations import Observation, Verdict, observation_of
from .suspects import suspects
from .visits import Visit, visits_of

# χ² by which another explanation must be worse; e^(-25/2) is one in 300,000.
_DECISIVE = 25.0
# What a corner that is left out counts: it lies beyond four sigmas.
_LEFT_OUT = 16.0
# An event must explain so many pictures of so many corners.
_LEAST_EXPLAINED = 2 * 12 * _LEFT_OUT
_MOST_OF_A_VISIT = 6
_MOST_EVENTS = 4
# So many pictures of a visit must be used for it to agree: one that is wrong may fit by accident,
# and a few of few corners may all be left out without anything being amiss.
_LEAST_AGREEING = 3


@dataclass(frozen=True, slots=True)
class _Trial:
    """How well visits fit where these events happened; `is_amiss`: not well; `agreeing`: the
    numbers of those that are used."""

    events: tuple[Upheaval, ...]
    score: float
    is_amiss: bool
    agreeing: frozenset[int]


def explained(data: DataSet, observations: list[Observation]) -> list[tuple[Upheaval, ...]]:
    """What must have happened for the observations to agree, for each that happened the events
    that explain it alike; nothing where no event explains clearly more of them than none.

    `data`: the site and the odometry; its entries are not used.
    """
    trials = _Trials(data, visits_of(data, observations))
    happened: list[tuple[Upheaval, ...]] = []
    for _ in range(_MOST_EVENTS):
        count = trials.first_amiss(flat(happened))
        if count is None:
            break
        found = trials.best(flat(happened), count)
        if not found:
            break
        happened.append(found)
    return happened


def flat(happened: list[tuple[Upheaval, ...]]) -> tuple[Upheaval, ...]:
    """All events in one row."""
    return tuple(event for alike in happened for event in alike)


class _Trials:
    """Works out visits with one event or another. Not thread-safe."""

    def __init__(self, data: DataSet, visits: list[Visit]) -> None:
        self._data, self._visits = data, visits
        self._tried: dict[tuple[int, tuple[Upheaval, ...]], _Trial] = {}

    def first_amiss(self, events: tuple[Upheaval, ...]) -> int | None:
        """After how many visits something does not fit any more; None where all of it fits."""
        good, bad = 0, len(self._visits)
        if not self._after(bad, events).is_amiss:
            return None
        while bad - good > 1:
            middle = (good + bad) // 2
            if self._after(middle, events).is_amiss:
                bad = middle
            else:
                good = middle
        return bad

    def best(self, events: tuple[Upheaval, ...], count: int) -> tuple[Upheaval, ...]:
        """Of what may be behind what shows in so many visits the events that explain best what
        came until something else does not fit; nothing where none explains it."""
        agreeing = self._after(count - 1, events).agreeing
        candidates = suspects(self._data, self._visits[:count], agreeing, events)
        trials = self._ranked(candidates, events, len(self._visits))
        if trials and trials[0].is_amiss:
            later = self.first_amiss(trials[0].events)
            assert later is not None  # it is amiss
            count = max(count, later - 1)
            trials = self._ranked(candidates, events, count)
        else:
            count = len(self._visits)
        if not trials:
            return ()
        without, best = self._after(count, events), trials[0]
        if without.score - best.score < _LEAST_EXPLAINED:
            return ()
        return tuple(t.events[-1] for t in trials if t.score - best.score < _DECISIVE)

    def _ranked(
        self, candidates: list[Upheaval], events: tuple[Upheaval, ...], count: int
    ) -> list[_Trial]:
        """Each candidate beside the events, best first."""
        trials = [self._after(count, (*events, candidate)) for candidate in candidates]
        return sorted(trials, key=lambda trial: trial.score)

    def _after(self, count: int, events: tuple[Upheaval, ...]) -> _Trial:
        """How well so many visits fit."""
        key = count, events
        if key not in self._tried:
            few = [o for visit in self._visits[:count] for o in visit.thinned(_MOST_OF_A_VISIT)]
            few.sort(key=lambda observation: observation.stamp_ns)
            batch, _ = solved_anew(with_events(self._data, events), few, gives_up=True)
            fitted, left_out = _fit(batch)
            is_amiss = left_out > _LEAST_EXPLAINED or is_denied(batch)
            agreeing = self._agreeing(batch)
            self._tried[key] = _Trial(events, fitted + left_out, is_amiss, agreeing)
        return self._tried[key]

    def _agreeing(self, batch: BatchSolution) -> frozenset[int]:
        """The numbers of the visits that a solution uses."""
        used = {
            (o.robot, self._data.site_camera(o.camera), o.stamp_ns)
            for o in (entry.observation for entry in batch.data.entries)
            if o.verdict is Verdict.ACCEPTED
        }
        counts = [
            sum((o.robot, o.camera, o.stamp_ns) in used for o in visit.observations)
            for visit in self._visits
        ]
        return frozenset(n for n, count in enumerate(counts) if count >= _LEAST_AGREEING)


def with_events(data: DataSet, events: tuple[Upheaval, ...]) -> DataSet:
    """The site and its odometry as they are with these events and no others, without entries."""
    known = _as_first_known(data)
    told = DataSet(data.site, data.targets, dict(data.lenses), known, dict(data.tracks))
    for name, track in data.tracks.items():
        told.tracks[name] = track.broken(
            (event.after_ns, event.before_ns)
            for event in events
            if isinstance(event, Lift) and event.robot == name
        )
    _take_moves(told, events)
    return told


def _as_first_known(data: DataSet) -> KnownCameras:
    poses = {data.site_camera(name): pose for name, pose in data.known.poses.items()}
    return KnownCameras(poses, data.known.information)


def _take_moves(data: DataSet, events: tuple[Upheaval, ...]) -> None:
    """Have a camera for each earlier place of one."""
    knocks = sorted((e for e in events if isinstance(e, Knock)), key=lambda knock: knock.since_ns)
    for knock in knocks:
        number = 1 + sum(move.camera == knock.camera for move in data.moves)
        name = f"{knock.camera}@{number}"
        if number == 1:  # what was known of it is known of its first place
            poses = data.known.poses.items()
            renamed = {name if key == knock.camera else key: pose for key, pose in poses}
            data.known = KnownCameras(renamed, data.known.information)
        data.lenses[name] = data.lenses[knock.camera]
        data.moves.append(Move(knock.camera, name, knock.since_ns, knock.until_ns))


def anew(data: DataSet, observation: Observation) -> Observation:
    """An observation as it came, as one of where its camera was then."""
    camera = data.site_camera(observation.camera)
    fresh = observation_of(camera, observation.robot, observation.stamp_ns, observation.views)
    for move in data.moves:
        if move.camera == camera and observation.stamp_ns < move.since_ns:
            return replace(fresh, camera=move.name)
    return fresh


def solved_anew(
    data: DataSet, observations: list[Observation], *, gives_up: bool = False
) -> tuple[BatchSolution, Filter | None]:
    """Everything over a data set without entries, from the beginning; `gives_up` as for the batch
    solution's `finish`."""
    batch = BatchSolution(data)
    batch.collected = [anew(data, observation) for observation in observations]
    return batch, batch.finish(Filter.at_origin(data), gives_up=gives_up)


def take(data: DataSet, happened: list[tuple[Upheaval, ...]]) -> None:
    """Make a data set one with these events and no others, and without entries."""
    told = with_events(data, flat(happened))
    data.known, data.lenses, data.moves = told.known, told.lenses, told.moves
    for name, track in data.tracks.items():
        track.mend()
        for event in flat(happened):
            if isinstance(event, Lift) and event.robot == name:
                track.break_between(event.after_ns, event.before_ns)
    data.forget_from(0)
    data.happened = happened


def _fit(batch: BatchSolution) -> tuple[float, float]:
    """χ² of what is used, and what is left out as if it lay just beyond the limit."""
    fitted = batch.solution.cost if batch.solution is not None else 0.0
    left_out = 0.0
    for entry in batch.data.entries:
        observation = entry.observation
        if observation.verdict is Verdict.ACCEPTED:
            left_out += _LEFT_OUT * sum(int(np.sum(wild)) for wild in observation.outliers)
        elif entry.map_from_base is None and observation.camera not in batch.state.cameras:
            fitted += 2 * observation.corner_count  # nothing is known that it could contradict
        else:
            left_out += _LEFT_OUT * observation.corner_count
    return fitted, left_out
