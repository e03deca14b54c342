"""Tails and limits of the χ² distribution, held to scipy's."""

import math

import pytest
from scipy.special import chdtrc, chdtri

from trigpoint.geometry.chi_square import chi2_limit, chi2_tail

# Poses in the plane and in space, noise that is learnt, and corners of up to eight large boards.
FREEDOMS = [*range(1, 201), 351, 352, 1001, 1600]
PROBABILITIES = (0.5, 0.05, 1e-2, 1e-3, 1e-3 / 7, 1e-5, 1e-12)


@pytest.mark.parametrize("probability", PROBABILITIES)
def test_a_limit_is_exceeded_with_its_probability(probability: float) -> None:
    found = [chi2_limit(freedom, probability) for freedom in FREEDOMS]
    assert found == pytest.approx(chdtri(FREEDOMS, probability), rel=1e-12, abs=0)


@pytest.mark.parametrize("chi2", [1e-9, 0.3, 5.0, 40.0, 600.0, 2000.0])
def test_a_tail_is_known_however_small_it_is(chi2: float) -> None:
    found = [chi2_tail(freedom, chi2) for freedom in FREEDOMS]
    assert found == pytest.approx(chdtrc(FREEDOMS, chi2), rel=1e-12, abs=1e-300)


def test_nothing_is_below_zero_and_nothing_beyond_all() -> None:
    assert chi2_tail(3, 0.0) == chi2_tail(2, -1.0) == 1.0
    assert chi2_tail(3, math.inf) == 0.0
    assert chi2_tail(0, 0.0) == 1.0  # of nothing that was measured
