"""What the oracle says of a camera, from the masses of all explanations.

Part of the oracle (`oracle`).
"""

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from support.oracle.views import Label

from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

EVIDENCE = 1e-5
# One place: within so much χ² of both places' covariances, and so many of the better one's sigmas,
# or so many metres.
_SAME_CHI2, _SAME_SIGMAS, _SAME_M = 50.0, 8.0, 0.1


class Explanation(Struct, frozen=True):
    """What may have happened. `readings`: an index for each picture; `lifts`: pictures before which
    the robot was lifted; `moves`: pictures before which their camera was moved."""

    readings: tuple[int, ...] = ()
    lifts: frozenset[int] = frozenset()
    moves: frozenset[int] = frozenset()


class Scored(Struct, frozen=True, eq=False):
    """`places`: map_from_camera and its covariance at the end, by camera; a camera is missing where
    all sightings of its last place are wrong, or a lift cuts it off the map (`cut_off`)."""

    explanation: Explanation
    labels: tuple[tuple[Label, ...], ...]
    cost: float
    places: dict[str, tuple[Pose, Array]]
    cut_off: frozenset[str] = frozenset()


class Place(Struct, frozen=True, eq=False):
    """Where a camera may be, with the mass of all explanations that put it there."""

    map_from_camera: Pose
    covariance: Array
    mass: float


class Verdict(Struct, frozen=True, eq=False):
    """What the posterior says of a camera's last place, best first. `by_wrong`, `by_lift`: the mass
    of explanations by which the data do not place it: all its sightings there are wrong; the robot
    was lifted and no other picture ties it to the map."""

    camera: str
    places: tuple[Place, ...]
    by_wrong: float
    by_lift: float

    @property
    def elsewhere(self) -> float:
        """The share of the other places of all explanations that place it."""
        masses = [place.mass for place in self.places]
        return sum(masses[1:]) / sum(masses) if masses else 1.0

    @property
    def is_located(self) -> bool:
        """One place holds all but EVIDENCE of what does not take all its sightings to be wrong, and
        that is more than half."""
        return self.elsewhere + self.by_lift <= EVIDENCE and self.by_wrong < 0.5

    @property
    def is_confirmed(self) -> bool:
        """Not resting on sightings that may all be wrong."""
        return self.by_wrong <= EVIDENCE

    def is_clear(self, factor: float = 30.0) -> bool:
        """Whether the verdict does not hang on a factor of this size in the odds."""
        return not EVIDENCE / factor < self.elsewhere + self.by_lift < EVIDENCE * factor


def verdict_of(camera: str, scored: list[Scored], masses: Array) -> Verdict:
    """Of one camera, from explanations and their shares (n,) of the posterior."""
    places: list[Place] = []
    by_wrong = by_lift = 0.0
    for one, mass in zip(scored, masses.tolist(), strict=True):
        if camera in one.places:
            _put(places, *one.places[camera], mass)
        elif camera in one.cut_off:
            by_lift += mass
        else:
            by_wrong += mass
    ordered = tuple(sorted(places, key=lambda place: -place.mass))
    return Verdict(camera, ordered, by_wrong, by_lift)


def _put(places: list[Place], pose: Pose, covariance: Array, mass: float) -> None:
    """Add to the place that this is, or as one of its own."""
    for index, place in enumerate(places):
        if is_one_place(place, pose, covariance):
            places[index] = replace(place, mass=place.mass + mass)
            return
    places.append(Place(pose, covariance, mass))


def is_one_place(place: Place, pose: Pose, covariance: Array) -> bool:
    """Whether a pose with its covariance (6, 6) is at a place."""
    if apart(pose, place.map_from_camera, place.covariance + covariance) > _SAME_CHI2:
        return False
    error = (pose.translation - place.map_from_camera.translation)[:3]
    sigmas = float(np.sqrt(error @ np.linalg.solve(place.covariance[:3, :3], error)))
    return sigmas < _SAME_SIGMAS or float(np.linalg.norm(error)) < _SAME_M


def apart(pose: Pose, other: Pose, covariance: Array) -> float:
    """χ² between two poses."""
    error = pose.difference(other)
    return float(error @ np.linalg.solve(covariance, error))
