"""How probable it is, before any data, that something other than a good sighting happened.

Every decision of the association compares posteriors (`score` is minus twice the logarithm of one,
up to a constant that all explanations of a session share); these are its priors, and `EVIDENCE` the
one level at which it is held. Nothing else in the package is a threshold.
"""

import math
from dataclasses import dataclass

# What the explanations that place a camera elsewhere may hold together of the posterior.
EVIDENCE = 1e-5


@dataclass(frozen=True, slots=True)
class Events:
    """Prior probabilities, each for one occasion, and the room of places.

    `wrong_sighting`: a sighting that shows something else than its robot as it stands;
    `wild_corner`: a good corner that is so far from where the others put it that it is left out;
    `disturbed`: somebody carried a robot or moved a camera in the session at all; `event`: in such
    a session, the robot is put down elsewhere between two visits, or a camera is moved between two
    visits to it (whoever meddles once is likely to do it again); `noise`: the noise is far
    otherwise than stated, in a session that does not tell; `room`: lengths (m) of the box in which
    cameras hang and robots drive.
    """

    wrong_sighting: float = 0.02
    wild_corner: float = 1e-4
    disturbed: float = 1e-6
    event: float = 1e-2
    noise: float = 5e-4
    room: tuple[float, float, float] = (30.0, 30.0, 5.0)

    @property
    def pose_score(self) -> float:
        """Of a pose anywhere in the room: 2 ln V - 6 ln 2π, V in m³ rad³ (all turns: 8π²)."""
        volume = math.prod(self.room) * 8 * math.pi**2
        return 2 * math.log(volume) - 6 * math.log(2 * math.pi)

    @property
    def wrong_score(self) -> float:
        """Of a sighting that is wrong, beside the pose that its board has then."""
        return 2 * math.log((1 - self.wrong_sighting) / self.wrong_sighting)

    def happened(self, count: int) -> float:
        """Of so many lifts and moves, beside where robot and cameras are put."""
        return -2 * math.log(self.disturbed) + count * self.event_score if count else 0.0

    @property
    def event_score(self) -> float:
        """Of one more lift or move where there were some."""
        return -2 * math.log(self.event)

    @property
    def noise_score(self) -> float:
        """Of a session whose noise is far otherwise than stated."""
        return -2 * math.log(self.noise)

    @property
    def wild_score(self) -> float:
        """Of a wild corner: the χ² that a good one exceeds so rarely (two degrees of freedom)."""
        return -2 * math.log(self.wild_corner)


def window() -> float:
    """The score by which one explanation must be worse than another to hold less than EVIDENCE."""
    return -2 * math.log(EVIDENCE)
