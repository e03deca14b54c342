"""Whether what cameras saw fits a robot's odometry only if that is told by another convention.

A mirrored drive, or one of other lengths, is a drive, too: odometry alone does not show that its
axes or its unit are wrong, and the search explains much by lifts and wrong sightings. So the
session is explained as it was told and with the odometry told in the other ways that people mean,
of those that the motion in single pictures does not contradict; by the one score, the likeliest is
what happened.
"""

import math
from collections.abc import Callable, Mapping

import numpy as np
from msgspec.structs import replace

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.motion import STILL
from trigpoint.fusion.model.observations import Observation, Verdict
from trigpoint.fusion.model.odometry import OdometryTrack
from trigpoint.geometry.rotation import Array

from .budget import Budget
from .events import Events, window
from .learning import SessionNoise
from .memory import Memory
from .noise import PESSIMISTIC
from .shown_motion import shown_motion
from .visits import visits_of
from .world import World

# For all explanations together: of the budget for the session's length; and how many of the visits,
# those with the most pictures.
_SHARE, _MOST_VISITS = 0.1, 12
# Each of two explanations may be off by as much as decides.
CLEAR = 2 * window()
# Of the sightings: more that contradict the rest are not only wrong ones.
MOST_REJECTED = 0.1
_MIRROR = np.diag([1.0, -1, 1, -1, 1, -1])
"""The twist (6,) of the mirrored drive by that of a drive."""
_BACKWARDS = np.diag([-1.0, -1, 1, 1, 1, 1])
# Lengths that are off by less are a wheel's radius or a print's scale; by less than the other,
# where these are not estimated, no more than pictures tell.
_OTHER_LENGTHS, _LEAST_OTHER = 1.25, 1.05
# Single boards tell motion to some centimetres and degrees (m or rad): what fits them worse by more
# than that, and so many times worse, is not explained at all.
_ROUGH, _MUCH_WORSE = 0.05, 1.5
_FEET, _DIAMETERS, _NEAR = 1 / 0.3048, 2.0, 0.05


def _with_other_heading(track: OdometryTrack, turns: float) -> Array:
    """Of each step, the map (n, 6, 6) that turns its way by so many times the heading before."""
    angles = turns * np.concatenate([[0.0], track.odom_from_base.heading[:-1]])
    maps = np.tile(np.eye(6), (len(angles), 1, 1))
    maps[:, 0, 0] = maps[:, 1, 1] = np.cos(angles)
    maps[:, 1, 0] = np.sin(angles)
    maps[:, 0, 1] = -maps[:, 1, 0]
    return maps


_HEADING_ONLY = np.diag([1.0, 1, 1, 1, 1, -1])
_WAY_ONLY = np.diag([1.0, -1, 1, 1, 1, 1])
_OTHERWISE: Mapping[str, Callable[[OdometryTrack], Array]] = {
    "that is mirrored (NED, FRD: turns to the left are told as turns to the right), or its target "
    "file has left and right exchanged": lambda _track: _MIRROR,
    "its y axis is to the right": lambda track: _with_other_heading(track, -2) @ _WAY_ONLY,
    "its x axis is backwards": (
        lambda track: _with_other_heading(track, -2) @ _WAY_ONLY @ _BACKWARDS
    ),
    "its headings turn to the right": lambda track: _with_other_heading(track, 2) @ _HEADING_ONLY,
    "it drove backwards where it tells forwards, or its target file has front and back exchanged": (
        lambda _track: _BACKWARDS
    ),
}
"""What else a robot may mean -> the map of each step's twist (6,), or of each its own (n, 6, 6), to
what that is by the contract."""


def otherwise(data: DataSet) -> dict[str, str]:
    """Robot -> how its odometry is told, or its target is, where that explains what was seen far
    better than the contract's way; all ways that explain it as well. `data`: after its last
    explanation; where that shows nothing strange, none is questioned."""
    every = [entry.observation for entry in data.entries]
    unused = sum(observation.verdict is not Verdict.ACCEPTED for observation in every)
    if not data.changes and unused <= MOST_REJECTED * len(every):
        return {}
    every = [as_it_came(data, each) for each in every]
    every.sort(key=lambda observation: observation.stamp_ns)
    draft = data.draft()
    ways = {
        robot: found
        for robot in dict.fromkeys(observation.robot for observation in every)
        if (found := _retold(draft, robot, every))
    }
    if not ways:
        return {}
    # The same share for each, so that the last robot is not left without.
    budget = Budget.of(data.tracks.values(), share=_SHARE / (1 + len(ways)))
    memory = Memory(replace(budget))
    told = _score(draft, every, memory)
    if not np.isfinite(told):
        return {}
    found = dict[str, str]()
    for robot, tracks in ways.items():
        mine = Memory(replace(budget), memory.alone)
        scores = {
            words: _score(replace(draft, tracks=draft.tracks | {robot: track}), every, mine)
            for words, track in tracks.items()
        }
        best = min(scores.values())
        if best + CLEAR < told:
            found[robot] = ", or ".join(w for w, score in scores.items() if score < best + CLEAR)
    return found


def _retold(data: DataSet, robot: str, every: list[Observation]) -> dict[str, OdometryTrack]:
    """A robot's odometry told in each other way, in words, that the motion in single pictures does
    not contradict; what fits that best comes first, and none where odometry never moves."""
    track = data.tracks[robot]
    if not len(track) or np.ptp(track.odom_from_base.rows(), axis=0).max() < STILL:
        return {}
    found = {words: track.retold(maps(track)) for words, maps in _OTHERWISE.items()}
    visits = [visit for visit in visits_of(data, every) if visit.robot == robot]
    visits = sorted(visits, key=lambda visit: -len(visit.indices))[:_MOST_VISITS]
    shown = shown_motion(data, every, visits)
    if shown is None:
        return found
    by = shown.longer(track)
    is_learnt = data.site.robots[robot].odometry.distance_scale > 0
    if abs(math.log(by)) > math.log(_OTHER_LENGTHS if is_learnt else _LEAST_OTHER):
        found[other_lengths(by)] = track.retold(np.diag([1 / by] * 3 + [1.0] * 3))
    misfits = {words: shown.misfit(each) for words, each in found.items()}
    most = _ROUGH + _MUCH_WORSE * shown.misfit(track)
    return {
        words: found[words]
        for words in sorted(misfits, key=misfits.__getitem__)
        if misfits[words] < most
    }


def other_lengths(by: float) -> str:
    """That odometry tells lengths so many times as long as they are seen, and what that may be."""
    hints = {_FEET: " (feet, 3.28?)", _DIAMETERS: " (diameters for radii of wheels, 2?)"}
    hint = next((words for of, words in hints.items() if abs(by / of - 1) < _NEAR), "")
    if abs(math.log(by)) < math.log(_OTHER_LENGTHS):
        hint = " (a wheel's radius? distance_scale = 0.1 has that learnt)"
    odometry, target = ("long", "short") if by > 1 else ("short", "long")
    times = f"{max(by, 1 / by):.3g} times too"
    return (
        f"its lengths are told {times} {odometry}{hint}, or those in its target file are {times} "
        f"{target} for what was printed"
    )


def other_turns(by: float) -> str:
    """That odometry tells turns so many times as large as they are seen, and what that may be."""
    return (
        f"its turns are told {max(by, 1 / by):.3g} times too {'large' if by > 1 else 'small'} (the "
        "wheels' distance? heading_scale = 0.1 has that learnt)"
    )


def as_it_came(data: DataSet, seen: Observation) -> Observation:
    """An observation without what was concluded of it."""
    camera = data.site_camera(seen.camera)
    return replace(seen, camera=camera, chosen=None, verdict=Verdict.PENDING, outliers=())


def _score(data: DataSet, observations: list[Observation], memory: Memory) -> float:
    """The score of what explains observations best, inf where the budget does not suffice;
    `memory`: of which only that and what holds for any odometry is used."""
    world = world_of(data, observations, memory)
    return np.inf if world.budget.is_spent else world.score


def world_of(data: DataSet, observations: list[Observation], memory: Memory) -> World:
    """What explains the visits with the most pictures; see `_score`."""
    events = Events(data.site.fusion.priors)
    visits = sorted(visits_of(data, observations), key=lambda visit: -len(visit.indices))
    noise = SessionNoise(dict.fromkeys(data.site.robots, PESSIMISTIC))
    own = Memory(memory.budget, memory.alone)
    return World(data, observations, events, noise, own, visits[:_MOST_VISITS], is_draft=True)
