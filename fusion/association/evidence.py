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
    leaders: list[Place] = []
    masses: list[float] = []
    spreads: list[Array] = []
    for place, weight in zip(ordered, weights.tolist(), strict=True):
        for order, leader in enumerate(leaders):
            if is_same_place(leader, place):
                apart = place.map_from_camera.difference(leader.map_from_camera)
                masses[order] += weight
                spreads[order] += weight * np.outer(apart, apart)
                break
        else:
            leaders.append(place)
            masses.append(weight)
            spreads.append(np.zeros((6, 6)))
    found = [
        Alternative(leader.map_from_camera, leader.covariance, mass, spread / mass)
        for leader, mass, spread in zip(leaders, masses, spreads, strict=True)
    ]
    found.sort(key=lambda alternative: -alternative.probability)
    rest = 1.0
    for count, alternative in enumerate(found, start=1):
        rest -= alternative.probability
        if rest < EVIDENCE:
            return tuple(found[:count])
    return tuple(found)


def is_same_place(first: Place, second: Place) -> bool:
    """Whether two explanations put a camera at one place; `first`: the likelier one."""
    apart = np.abs(second.map_from_camera.difference(first.map_from_camera))
    if np.all(apart < np.repeat([_SAME_M, _SAME_RAD], 3)):
        return True
    sigma = np.sqrt(np.diagonal(first.covariance))
    return bool(np.all(apart < _SAME_SIGMAS * sigma + 1e-4))
