"""How probable it is, before any data, that something other than a good sighting happened.

Every decision of the association compares posteriors (a `score` is minus twice the logarithm of
one, up to a constant that all explanations of a session share). The site file states the priors
(`[fusion.priors]`), and `EVIDENCE` is the one level of significance. Thresholds elsewhere only say
what is not worth a look, or what is too small to matter.
"""

import math

import numpy as np
from msgspec import Struct, field

from trigpoint.geometry.chi_square import chi2_limit
from trigpoint.geometry.rotation import Array
from trigpoint.site.config import PriorConfig

# The share of the posterior that all explanations that put a camera elsewhere may hold together.
EVIDENCE = 1e-5


class Events(Struct, frozen=True):
    """The scores of what may happen, from the site's `priors`."""

    priors: PriorConfig = field(default_factory=PriorConfig)

    @property
    def pose_score(self) -> float:
        """The score of a pose anywhere in the room: 2 ln V - 6 ln 2π, with the volume V in m³ rad³
        (all rotations: 8π²)."""
        volume = math.prod(self.priors.room) * 8 * math.pi**2
        return 2 * math.log(volume) - 6 * math.log(2 * math.pi)

    @property
    def push(self) -> Array:
        """The covariance (6, 6) of a push of a camera, the same in any axes."""
        sigmas = self.priors.push_translation, self.priors.push_rotation
        return np.diag(np.square(np.repeat(sigmas, 3)))

    def moved(self, apart: float) -> float:
        """Return the score of a move of a camera, on top of that of its new pose anywhere in the
        room: every other camera that was moved was only pushed.

        `apart`: νᵀS⁻¹ν + ln |S| of the difference of the two poses, S including a push.
        """
        return -2 * float(np.logaddexp(0.0, 0.5 * (self.pose_score - apart)) - math.log(2))

    @property
    def wrong_score(self) -> float:
        """The score of a wrong sighting, on top of that of the pose that its board then has."""
        return 2 * math.log((1 - self.priors.wrong_sighting) / self.priors.wrong_sighting)

    @property
    def room_variances(self) -> Array:
        """The variances (6,) of a pose anywhere in the room, m² and rad²: the weakest prior."""
        x, y, z = self.priors.room
        return np.array([x**2, y**2, z**2, *[(2 * np.pi) ** 2] * 3]) / 12

    @property
    def sighting_gate(self) -> float:
        """The χ² of a pose (six degrees of freedom) that a good sighting exceeds with probability
        `EVIDENCE`."""
        return chi2_limit(6, EVIDENCE)

    @property
    def wrong_limit(self) -> float:
        """The score above which a sighting is wrong: that of a board that may be anywhere."""
        return self.pose_score + self.wrong_score

    def over_anywhere(self, chi2: Array | float, spread: Array | float) -> Array:
        """Return by how much sightings are less probable than wrong ones whose boards may be
        anywhere. `chi2`: νᵀS⁻¹ν of the innovation of each pose; `spread`: ln |S|."""
        return np.asarray(chi2 + np.minimum(spread, self.pose_score) - self.wrong_limit)

    def excess(self, chi2: Array | float, spread: Array | float) -> Array:
        """Return the same, but also against wrong ones that are off by any, even small, amounts."""
        return np.maximum(self.over_anywhere(chi2, spread), np.subtract(chi2, self.sighting_gate))

    def happened(self, count: int) -> float:
        """Return the score of `count` lifts and moves, on top of those of the poses after them."""
        return -2 * math.log(self.priors.disturbed) + count * self.event_score if count else 0.0

    @property
    def event_score(self) -> float:
        """The score of one more lift or move in a session in which there were some."""
        return -2 * math.log(self.priors.event)

    @property
    def noise_score(self) -> float:
        """The score of a session whose noise is far from what is stated."""
        return -2 * math.log(self.priors.noise)

    @property
    def wild_score(self) -> float:
        """The score of a wild corner: the χ² (two degrees of freedom) that a good one exceeds with
        the prior probability of a wild one."""
        return -2 * math.log(self.priors.wild_corner)


def window() -> float:
    """Return by how much the score of one explanation must be worse than another's for it to be
    `EVIDENCE` times as probable."""
    return -2 * math.log(EVIDENCE)


def log_sum(scores: list[float]) -> float:
    """Return -2 ln Σ exp(-score/2), the score of all alternatives together."""
    if not scores:
        return np.inf
    least = min(scores)
    return least - 2 * float(np.log(sum(np.exp(-0.5 * (score - least)) for score in scores)))
