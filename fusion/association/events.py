"""How probable it is, before any data, that something other than a good sighting happened.

Every decision of the association compares posteriors (`score` is minus twice the logarithm of one,
up to a constant that all explanations of a session share); the site file states its priors
(`[fusion.priors]`), and `EVIDENCE` is the one level at which it is held. Thresholds elsewhere only
say what is not worth a look, or what is too little to matter.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.special import chdtri

from trigpoint.config import PriorConfig
from trigpoint.geometry.rotation import Array

# What the explanations that place a camera elsewhere may hold together of the posterior.
EVIDENCE = 1e-5


@dataclass(frozen=True, slots=True)
class Events:
    """The scores of what may happen, by the site's `priors`."""

    priors: PriorConfig = field(default_factory=PriorConfig)

    @property
    def pose_score(self) -> float:
        """Of a pose anywhere in the room: 2 ln V - 6 ln 2π, V in m³ rad³ (all turns: 8π²)."""
        volume = math.prod(self.priors.room) * 8 * math.pi**2
        return 2 * math.log(volume) - 6 * math.log(2 * math.pi)

    @property
    def push(self) -> Array:
        """The covariance (6, 6) of how far a camera is pushed, in any axes."""
        sigmas = self.priors.push_translation, self.priors.push_rotation
        return np.diag(np.square(np.repeat(sigmas, 3)))

    def moved(self, apart: float) -> float:
        """Of a camera that was moved, beside its pose anywhere in the room: every other one was
        only pushed. `apart`: νᵀS⁻¹ν + ln |S| of how far, with the covariance of a push in S."""
        return -2 * float(np.logaddexp(0.0, 0.5 * (self.pose_score - apart)) - math.log(2))

    @property
    def wrong_score(self) -> float:
        """Of a sighting that is wrong, beside the pose that its board has then."""
        return 2 * math.log((1 - self.priors.wrong_sighting) / self.priors.wrong_sighting)

    @property
    def room_variances(self) -> Array:
        """(6,): of a pose anywhere in the room, in m² and rad²; nothing is known less well."""
        x, y, z = self.priors.room
        return np.array([x**2, y**2, z**2, *[(2 * np.pi) ** 2] * 3]) / 12

    @property
    def sighting_gate(self) -> float:
        """The χ² of a pose (six degrees of freedom) beyond which a good sighting is no evidence."""
        return float(chdtri(6, EVIDENCE))

    @property
    def wrong_limit(self) -> float:
        """The score above which a sighting is wrong: that of a board which may be anywhere."""
        return self.pose_score + self.wrong_score

    def over_anywhere(self, chi2: Array | float, spread: Array | float) -> Array:
        """By how much sightings whose poses are off by νᵀS⁻¹ν, ln |S| (`spread`), are less probable
        than wrong ones whose boards may be anywhere."""
        return np.asarray(chi2 + np.minimum(spread, self.pose_score) - self.wrong_limit)

    def excess(self, chi2: Array | float, spread: Array | float) -> Array:
        """The same, and than wrong ones that are off by any amount, small ones too."""
        return np.maximum(self.over_anywhere(chi2, spread), np.subtract(chi2, self.sighting_gate))

    def happened(self, count: int) -> float:
        """Of so many lifts and moves, beside where robot and cameras are put."""
        return -2 * math.log(self.priors.disturbed) + count * self.event_score if count else 0.0

    @property
    def event_score(self) -> float:
        """Of one more lift or move where there were some."""
        return -2 * math.log(self.priors.event)

    @property
    def noise_score(self) -> float:
        """Of a session whose noise is far otherwise than stated."""
        return -2 * math.log(self.priors.noise)

    @property
    def wild_score(self) -> float:
        """Of a wild corner: the χ² that a good one exceeds so rarely (two degrees of freedom)."""
        return -2 * math.log(self.priors.wild_corner)


def window() -> float:
    """The score by which one explanation must be worse than another to hold less than EVIDENCE."""
    return -2 * math.log(EVIDENCE)
