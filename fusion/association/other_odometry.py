"""Whether what cameras saw fits a robot's odometry only if that is told by another convention.

A mirrored drive, or one of other lengths, is a drive, too: odometry alone does not show that its
axes or its unit are wrong, and the search explains much by lifts and wrong sightings. So the
session is explained as it was told and with the odometry told in the other ways that people mean;
by the one score, the likeliest is what happened.
"""

from collections.abc import Callable, Mapping

import numpy as np
from msgspec.structs import replace

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.observations import Observation, Verdict
from trigpoint.fusion.model.odometry import OdometryTrack
from trigpoint.geometry.rotation import Array

from .budget import Budget
from .events import Events, window
from .learning import SessionNoise
from .memory import Memory
from .noise import PESSIMISTIC
from .visits import visits_of
from .world import World

# For all explanations together: of the budget for the session's length; and how many of the visits,
# those with the most pictures.
_SHARE, _MOST_VISITS = 0.1, 12
# Each of the two explanations may be off by as much as decides.
_CLEAR = 2 * window()
# Of the sightings: more that contradict the rest are not only wrong ones.
_MOST_REJECTED = 0.1
_MIRROR = np.diag([1.0, -1, 1, -1, 1, -1])
"""The twist (6,) of the mirrored drive by that of a drive."""
_BACKWARDS = np.diag([-1.0, -1, 1, 1, 1, 1])
# How much longer odometry has been told: wheels by their diameter for their radius or the other way
# round, one or four of an encoder's edges for the other, feet, decimetres.
_TIMES = 2.0, 4.0, 1 / 0.3048, 10.0, 0.5, 0.25, 0.1


def _longer(times: float) -> Callable[[OdometryTrack], Array]:
    return lambda _track: np.diag([1 / times] * 3 + [1.0] * 3)


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
    "that is mirrored (NED, FRD: turns to the left are told as turns to the right)": (
        lambda _track: _MIRROR
    ),
    "its y axis is to the right": lambda track: _with_other_heading(track, -2) @ _WAY_ONLY,
    "its x axis is backwards": (
        lambda track: _with_other_heading(track, -2) @ _WAY_ONLY @ _BACKWARDS
    ),
    "its headings turn to the right": lambda track: _with_other_heading(track, 2) @ _HEADING_ONLY,
    "it drove backwards where it tells forwards": lambda _track: _BACKWARDS,
    **{f"its lengths are told {by:.3g} times as long as they are": _longer(by) for by in _TIMES},
}
"""What else a robot may mean -> the map of each step's twist (6,), or of each its own (n, 6, 6), to
what that is by the contract."""


def otherwise(data: DataSet) -> dict[str, str]:
    """Robot -> how its odometry is told, where that explains what was seen far better than the
    contract's way; all ways that explain it as well. `data`: after its last explanation; where that
    shows nothing strange, none is questioned."""
    every = [entry.observation for entry in data.entries]
    rejected = sum(observation.verdict is Verdict.REJECTED for observation in every)
    if not data.changes and rejected <= _MOST_REJECTED * len(every):
        return {}
    every = [_fresh(data, each) for each in every]
    every.sort(key=lambda observation: observation.stamp_ns)
    draft, memory = data.draft(), Memory(Budget.of(data.tracks.values(), share=_SHARE))
    told = _score(draft, every, memory)
    if not np.isfinite(told):
        return {}
    found = dict[str, str]()
    for robot in dict.fromkeys(observation.robot for observation in every):
        track = draft.tracks[robot]
        scores = {
            words: _score(
                replace(draft, tracks=draft.tracks | {robot: track.retold(maps(track))}),
                every,
                memory,
            )
            for words, maps in _OTHERWISE.items()
        }
        best = min(scores.values())
        if best + _CLEAR < told:
            found[robot] = ", or ".join(w for w, score in scores.items() if score < best + _CLEAR)
    return found


def _fresh(data: DataSet, seen: Observation) -> Observation:
    """An observation without what was concluded of it."""
    camera = data.site_camera(seen.camera)
    return replace(seen, camera=camera, chosen=None, verdict=Verdict.PENDING, outliers=())


def _score(data: DataSet, observations: list[Observation], memory: Memory) -> float:
    """The score of what explains observations best, inf where the budget does not suffice;
    `memory`: of which only that and what holds for any odometry is used."""
    events = Events(data.site.fusion.priors)
    visits = sorted(visits_of(data, observations), key=lambda visit: -len(visit.indices))
    noise = SessionNoise(dict.fromkeys(data.site.robots, PESSIMISTIC))
    own = Memory(memory.budget, memory.alone)
    visits = visits[:_MOST_VISITS]
    world = World(data, observations, events, noise, own, visits, is_draft=True)
    return np.inf if own.budget.is_spent else world.score
