"""The χ² distribution with whole degrees of freedom: the square of a vector of unit normals."""

import math
from functools import cache


def chi2_tail(freedom: int, chi2: float) -> float:
    """The probability of at least this χ².

    The upper tail at ν degrees of freedom is Q(ν/2, χ²/2); with x = χ²/2 it begins at
    Q(1/2, x) = erfc(√x) or Q(1, x) = e⁻ˣ, and Q(a + 1, x) = Q(a, x) + xᵃ e⁻ˣ / Γ(a + 1)
    (Abramowitz and Stegun 26.4.4, 26.4.5). All terms are positive: nothing cancels.
    """
    if chi2 <= 0 or chi2 == math.inf:
        return float(chi2 <= 0)
    half = chi2 / 2
    tail = math.erfc(math.sqrt(half)) if freedom % 2 else 0.0
    for twice in range(freedom % 2, freedom, 2):
        tail += math.exp(twice / 2 * math.log(half) - half - math.lgamma(twice / 2 + 1))
    return tail


@cache
def chi2_limit(freedom: int, probability: float) -> float:
    """The χ² that is exceeded with this probability, above 0 and below 1; by bisection."""
    if freedom == 0:
        return 0.0
    low, high = 0.0, float(freedom)
    while chi2_tail(freedom, high) > probability:
        low, high = high, 2 * high
    while low < (middle := (low + high) / 2) < high:
        low, high = (middle, high) if chi2_tail(freedom, middle) > probability else (low, middle)
    return middle
