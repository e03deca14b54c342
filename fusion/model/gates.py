"""Gates as probabilities: how often an inlier lies beyond each, and the χ² or sigmas that follow.

To change what is rejected, or how certain a choice must be, change a probability here.
"""

import math

from trigpoint.geometry.chi_square import chi2_tail

# Of two explanations (readings, poses, robots) one is chosen only where the likelihood of the
# other, relative to it, is below this.
_AMBIGUOUS = 1 / 300_000
# How often a corner of a good sighting lies beyond the gate.
_WILD_CORNER = 1 / 3000
# How often a good sighting lies beyond a filter's gate.
_WRONG_SIGHTING = 1e-5
# How often a corner of a standing robot lies farther than the gate from where another picture has
# it; the median of a view's corners never does.
_SAME_CORNER = 1 / 100


def length_gate(probability: float) -> float:
    """The length, in sigmas, that a normal vector in the plane exceeds with this probability."""
    return math.sqrt(-2 * math.log(probability))


# χ² by which the runner-up must be worse.
DECISIVE = -2 * math.log(_AMBIGUOUS)
WILD_CORNER_SIGMAS = length_gate(_WILD_CORNER)
# Beyond this residual a corner's cost is linear (Huber), while the initial values may be rough.
HUBER_SIGMAS = 4.0
# A view with a larger share of outlier corners is wrong.
WILD_SHARE = 0.25
# Between two pictures, each with its own noise.
SAME_CORNER_SIGMAS = math.sqrt(2) * length_gate(_SAME_CORNER)


def is_noise(chi2: float, freedom: int, *, excess: float = 1.0) -> bool:
    """Whether a sighting's normalised innovation squared passes the χ² gate, for a variance of up
    to `excess` times the known one."""
    return chi2_tail(freedom, chi2 / excess) >= _WRONG_SIGHTING
