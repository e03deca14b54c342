"""Gates let through as much of what is good as their probabilities say."""

import numpy as np
import pytest

from trigpoint.fusion.model.gates import DECISIVE, is_noise, length_gate
from trigpoint.geometry.chi_square import chi2_limit


@pytest.mark.parametrize("freedom", [1, 3, 6, 96])
def test_noise_exceeds_a_gate_as_often_as_it_is_said_to(freedom: int) -> None:
    chi2 = np.random.default_rng(freedom).chisquare(freedom, 200_000)
    assert np.mean(chi2 > chi2_limit(freedom, 0.01)) == pytest.approx(0.01, abs=0.001)


def test_lengths_in_the_plane_exceed_a_gate_as_often_as_it_is_said_to() -> None:
    length = np.linalg.norm(np.random.default_rng(1).normal(size=(200_000, 2)), axis=1)
    assert np.mean(length > length_gate(0.01)) == pytest.approx(0.01, abs=0.001)


def test_what_is_decisive_is_one_to_so_many() -> None:
    assert np.exp(-DECISIVE / 2) == pytest.approx(1 / 300_000)


@pytest.mark.parametrize(("sigmas", "verdict"), [(0.9, False), (1.1, True)])
def test_a_sighting_is_judged_at_its_gate(sigmas: float, verdict: bool) -> None:
    assert is_noise(25.9 * sigmas, 3) is not verdict
