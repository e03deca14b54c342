"""Weights and resampling of particles."""

import numpy as np
import pytest

from trigpoint.fusion.estimators.filters.particle_resampling import (
    effective_sample_size,
    independent_draws,
    largest_share,
    low_variance_indices,
    moments,
    normalised,
    resampled,
)

COUNT = 500


@pytest.fixture
def random() -> np.random.Generator:
    return np.random.default_rng(4)


def test_effective_sample_size_counts_the_particles_that_matter() -> None:
    assert effective_sample_size(np.full(8, 1 / 8)) == pytest.approx(8)
    assert effective_sample_size(np.array([0.5, 0.5, 0, 0])) == pytest.approx(2)
    assert effective_sample_size(np.array([1.0, 0, 0])) == pytest.approx(1)


def test_each_particle_comes_as_often_as_its_weight_says_to_within_one(
    random: np.random.Generator,
) -> None:
    weights = normalised(random.normal(0, 2, COUNT))
    times = np.bincount(low_variance_indices(weights, random), minlength=COUNT)
    assert np.all(np.abs(times - COUNT * weights) < 1)


def test_over_many_draws_each_particle_comes_as_often_as_its_weight_says(
    random: np.random.Generator,
) -> None:
    weights = normalised(random.normal(0, 1, 20))
    draws = 2000
    times = sum(
        np.bincount(low_variance_indices(weights, random), minlength=20) for _ in range(draws)
    )
    # A count is one of two neighbours, so its deviation is at most a half.
    np.testing.assert_allclose(times / draws, 20 * weights, atol=5 * 0.5 / np.sqrt(draws))


def test_resampling_leaves_numpys_own_generator_alone(random: np.random.Generator) -> None:
    np.random.seed(7)
    expected = np.random.random()
    np.random.seed(7)
    low_variance_indices(np.full(10, 0.1), random)
    assert np.random.random() == expected


def test_what_is_shown_has_the_weighted_mean_and_covariance_afterwards(
    random: np.random.Generator,
) -> None:
    errors = random.standard_normal((COUNT, 4)) @ random.standard_normal((4, 4))
    shown = errors[:, :2]
    weights = normalised(-0.5 * np.sum((shown - 0.5) ** 2, axis=1))
    mean, covariance = moments(shown, weights)
    moved, _ = resampled(errors, shown, weights, random)
    even = np.full(COUNT, 1 / COUNT)
    found_mean, found = moments(moved[:, :2], even)
    np.testing.assert_allclose(found_mean, mean, atol=1e-9)
    np.testing.assert_allclose(found, covariance, atol=1e-9)


def test_what_does_not_depend_on_what_is_shown_stays(random: np.random.Generator) -> None:
    shown = random.standard_normal((COUNT, 2))
    other = independent_draws(shown, 1, random)
    weights = normalised(-2 * (shown[:, 0] - 1) ** 2)
    moved, _ = resampled(np.column_stack([shown, other]), shown, weights, random)
    np.testing.assert_allclose(moved[:, 2:], other, atol=1e-9)


def test_what_depends_on_it_follows(random: np.random.Generator) -> None:
    shown = random.standard_normal((COUNT, 2))
    weights = normalised(-2 * (shown[:, 0] - 1) ** 2)
    moved, _ = resampled(np.column_stack([shown, 3 * shown[:, 0]]), shown, weights, random)
    np.testing.assert_allclose(moved[:, 2], 3 * moved[:, 0], atol=1e-6)


def test_copies_are_drawn_apart(random: np.random.Generator) -> None:
    shown = random.standard_normal((COUNT, 2))
    weights = normalised(-8 * np.sum(shown**2, axis=1))
    moved, indices = resampled(shown, shown, weights, random)
    assert len(np.unique(indices)) < COUNT / 3
    assert len(np.unique(moved[:, 0])) == COUNT


def test_draws_have_no_correlation_with_what_there_is(random: np.random.Generator) -> None:
    errors = random.standard_normal((COUNT, 5)) * np.array([1, 1e-3, 1e3, 1, 0])
    draws = independent_draws(errors, 3, random)
    np.testing.assert_allclose(draws.mean(axis=0), 0, atol=1e-9)
    np.testing.assert_allclose(draws.T @ draws / COUNT, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(draws.T @ errors[:, :4] / COUNT, 0, atol=1e-6)


def test_a_share_of_a_sharp_likelihood_leaves_half_of_the_particles(
    random: np.random.Generator,
) -> None:
    log_likelihood = -5000 * random.standard_normal(COUNT) ** 2
    share = largest_share(log_likelihood, 1.0)
    assert 0 < share < 0.01
    effective = effective_sample_size(normalised(share * log_likelihood))
    assert effective == pytest.approx(COUNT / 2, rel=0.05)


def test_a_dull_likelihood_is_taken_whole(random: np.random.Generator) -> None:
    assert largest_share(1e-3 * random.standard_normal(COUNT), 0.7) == 0.7
