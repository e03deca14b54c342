"""The one rule of evidence: a camera is located if the explanations that together hold all but
`EVIDENCE` of the posterior put it at one place."""

from collections.abc import Iterable

import numpy as np
from msgspec import Struct

from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from .events import EVIDENCE
from .explanation import Alternative

# Two places count as one if they differ in each direction by at most this many sigmas of the
# likelier one, whose covariance is the one reported, or by so little (m, rad) that nobody who acts
# on them can tell.
_SAME_SIGMAS = 5.0
_SAME_M = 0.01
_SAME_RAD = 0.01


class Place(Struct, frozen=True):
    """Where one explanation puts a camera, with its `covariance` (6, 6); `score`: of the
    explanation."""

    map_from_camera: Pose
    covariance: Array
    score: float


def alternatives_of(places: Iterable[Place]) -> tuple[Alternative, ...]:
    """Return the fewest distinct places that together hold all but `EVIDENCE` of the posterior,
    the most probable first."""
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
    apart = np.abs(apart)
    is_near = np.all(apart < np.repeat([_SAME_M, _SAME_RAD], 3), axis=1)
    return is_near | np.all(apart < _SAME_SIGMAS * np.sqrt(np.diagonal(covariance)) + 1e-4, axis=1)
