"""Whether what cameras saw fits a robot's odometry only if that is mirrored.

A mirrored drive is a drive, too: odometry alone does not show that its y axis and its heading have
the wrong sign, and with one camera the search explains much by lifts and wrong sightings. So the
session is explained as it was told and with the odometry mirrored; by the one score, the likelier
is what happened.
"""

import numpy as np
from msgspec.structs import replace

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.observations import Observation, Verdict

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


def mirrored(data: DataSet) -> list[str]:
    """The robots of which what was seen is explained far better by mirrored odometry. `data`: after
    its last explanation; where that shows nothing strange, it is not questioned."""
    every = [entry.observation for entry in data.entries]
    rejected = sum(observation.verdict is Verdict.REJECTED for observation in every)
    if not data.changes and rejected <= _MOST_REJECTED * len(every):
        return []
    every = [_fresh(data, each) for each in every]
    every.sort(key=lambda observation: observation.stamp_ns)
    draft, memory = data.draft(), Memory(Budget.of(data.tracks.values(), share=_SHARE))
    told = _score(draft, every, memory)
    if not np.isfinite(told):
        return []
    found = list[str]()
    for robot in dict.fromkeys(observation.robot for observation in every):
        tracks = draft.tracks | {robot: draft.tracks[robot].retold(_MIRROR)}
        if _score(replace(draft, tracks=tracks), every, memory) + _CLEAR < told:
            found.append(robot)
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
