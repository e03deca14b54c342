"""The result of data association: what is taken to have happened in a session, as plain values."""

from collections.abc import Iterable

import numpy as np
from msgspec import Struct

from trigpoint.fusion.model.dataset import CameraMove, Lift
from trigpoint.fusion.model.observations import Observation, Reading
from trigpoint.fusion.model.problem import CameraState
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from .events import EVIDENCE
from .noise import Noise

# Two places count as one if they differ in each direction by at most this many sigmas of the
# likelier one, whose covariance is the one reported, or by so little (m, rad) that nobody who acts
# on them can tell.
_SAME_SIGMAS = 5.0
_SAME_M = 0.01
_SAME_RAD = 0.01


class Alternative(Struct, frozen=True):
    """One place where a camera may be. `covariance` (6, 6): of the pose; `probability`: its share
    of the posterior; `spread` (6, 6): the second moment, about this pose, of the poses of all
    explanations that count as this place."""

    map_from_camera: Pose
    covariance: Array
    probability: float
    spread: Array


class CameraFinding(Struct, frozen=True):
    """Where one camera is at the end of the session. `alternatives`: the fewest places that
    together hold all but the level of evidence of the posterior, best first; `reason`: why the
    camera is not located, in words; empty if it is."""

    alternatives: tuple[Alternative, ...]
    reason: str = ""

    @property
    def is_located(self) -> bool:
        return not self.reason and len(self.alternatives) == 1


class Read(Struct, frozen=True):
    """How one observation is read. `readings`: one for each view, None for a wrong one; `wild`:
    which corners of each view are wild; `map_from_base`: where the robot stood, None if unknown;
    `place`: the number of the camera's place."""

    readings: tuple[Reading | None, ...]
    wild: tuple[np.ndarray, ...]
    map_from_base: Pose | None
    place: int


class Explanation(Struct, frozen=True):
    """The likeliest explanation of a session, with the alternatives that remain open.

    `observations`: in the order given, their corners' noise as learnt; `reads`: one for each;
    `findings`: by camera; `places`: by (camera, number of its place), the camera there, if that
    place is determined without alternatives; `lifts`: for each lift, all that explain the session
    nearly as well, the likeliest first; `noise`: by robot; `corner_scale`: by camera, how many
    times as much as stated its corners scatter.
    """

    observations: tuple[Observation, ...]
    reads: tuple[Read, ...]
    findings: dict[str, CameraFinding]
    places: dict[tuple[str, int], CameraState]
    lifts: tuple[tuple[Lift, ...], ...]
    moves: tuple[CameraMove, ...]
    noise: dict[str, Noise]
    corner_scale: dict[str, float]


class Place(Struct, frozen=True):
    """Where one explanation puts a camera, with its `covariance` (6, 6); `score`: of the
    explanation."""

    map_from_camera: Pose
    covariance: Array
    score: float


def alternatives_of(places: Iterable[Place]) -> tuple[Alternative, ...]:
    """Return the fewest distinct places that together hold all but `EVIDENCE` of the posterior,
    the most probable first: the one rule of evidence, by which a camera is located if there is one
    such place."""
    ordered = sorted(places, key=lambda place: place.score)
    if not ordered:
        return ()
    weights = np.exp(-0.5 * (np.array([p.score for p in ordered]) - ordered[0].score))
    weights /= weights.sum()
    poses, left = Pose.stack([place.map_from_camera for place in ordered]), np.arange(len(ordered))
    found = list[Alternative]()
    while len(left):
        leader = ordered[left[0]]
        apart = poses[left].difference(leader.map_from_camera)
        is_same = are_same_place(apart, leader.covariance)
        is_same[0] = True  # of itself, whatever its numbers
        mine, apart = weights[left[is_same]], apart[is_same]
        mass, spread = float(mine.sum()), (mine * apart.T) @ apart
        found.append(Alternative(leader.map_from_camera, leader.covariance, mass, spread / mass))
        left = left[~is_same]
    found.sort(key=lambda alternative: -alternative.probability)
    rest = 1.0
    for count, alternative in enumerate(found, start=1):
        rest -= alternative.probability
        if rest < EVIDENCE:
            return tuple(found[:count])
    return tuple(found)


def are_same_place(apart: Array, covariance: Array) -> np.ndarray:
    """Which explanations put a camera where the likeliest of them does, (n,): by their differences
    (n, 6) from that one, whose covariance is (6, 6)."""
    limits = _SAME_SIGMAS * np.sqrt(np.diagonal(covariance)) + 1e-4
    return are_little(apart) | np.all(np.abs(apart) < limits, axis=1)


def are_little(apart: Array) -> np.ndarray:
    """Which differences (n, 6) of poses are so little that nobody who acts on them can tell."""
    return np.all(np.abs(apart) < np.repeat([_SAME_M, _SAME_RAD], 3), axis=-1)
