"""Weights of particles: effective sample size, low-variance resampling, and small steps of it."""

from collections.abc import Callable

import numpy as np
from filterpy.monte_carlo import systematic_resample

from trigpoint.geometry.rotation import Array

# How far a copy is drawn apart from its original, as a share of the spread (Liu and West, «Combined
# parameter and state estimation in simulation-based filtering», 2001).
_APART = 0.3
# Keeps a spread of nothing (the map's origin) positive: 0.1 µm and µrad.
_FLOOR_VARIANCE = 1e-14


def normalised(log_weights: Array) -> Array:
    """Weights (n,) that sum to 1."""
    weights = np.exp(log_weights - log_weights.max())
    return weights / weights.sum()


def effective_sample_size(weights: Array) -> float:
    """1/Σw²: as many equally weighted particles would know as much (Kong, Liu and Wong, 1994)."""
    return float(1 / np.sum(weights**2))


def low_variance_indices(weights: Array, random: np.random.Generator) -> np.ndarray:
    """Indices (n,) by systematic resampling: a particle of weight w comes ⌊nw⌋ or ⌈nw⌉ times.

    filterpy draws from numpy's one global generator, which is seeded for it and put back.
    """
    before = np.random.get_state()
    np.random.seed(int(random.integers(2**32)))
    try:
        # The sum may end a rounding below the last position.
        return systematic_resample(weights * (1 + 1e-12))
    finally:
        np.random.set_state(before)


def resampled(
    errors: Array, weights: Array, random: np.random.Generator
) -> tuple[np.ndarray, Array]:
    """Equally weighted particles in place of weighted ones: indices (n,), and errors (n, D).

    Copies are drawn apart by a Gaussian kernel that keeps the spread as it is, and then moved
    together so that mean and covariance are exactly the weighted ones: resampling adds no noise of
    its own to them, however often it is done.
    """
    mean, covariance = moments(errors, weights)
    indices = low_variance_indices(weights, random)
    root = np.linalg.cholesky(covariance + _FLOOR_VARIANCE * np.eye(len(mean)))
    draws = random.standard_normal(errors.shape) @ root.T
    spread = mean + np.sqrt(1 - _APART**2) * (errors[indices] - mean) + _APART * draws
    even = np.full(len(errors), 1 / len(errors))
    have_mean, have = moments(spread, even)
    have_root = np.linalg.cholesky(have + _FLOOR_VARIANCE * np.eye(len(mean)))
    exact = np.linalg.solve(have_root, (spread - have_mean).T)
    return indices, mean + (root @ exact).T


def moments(errors: Array, weights: Array) -> tuple[Array, Array]:
    """Weighted mean (D,) and covariance (D, D) of errors (n, D).

    Divided by 1 - Σw², without which a covariance shrinks by a sample's worth at every resampling.
    """
    mean = weights @ errors
    apart = errors - mean
    return mean, (apart * weights[:, None]).T @ apart / (1 - np.sum(weights**2))


def largest_share(log_weights: Array, log_likelihood: Array, most: float) -> float:
    """The largest exponent up to `most` of a likelihood that leaves half of the weight effective.

    A sighting that knows far more than the particles is taken in such shares, with resampling in
    between (tempering: Neal, «Annealed importance sampling», 2001).
    """

    def is_kept(share: float) -> bool:
        weights = normalised(log_weights + share * log_likelihood)
        return effective_sample_size(weights) >= len(log_weights) / 2

    return most if is_kept(most) else _bisected(is_kept, most)


def _bisected(is_kept: Callable[[float], bool], most: float) -> float:
    low, high = 0.0, most
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if is_kept(middle) else (low, middle)
        if low > 0 and high - low < 0.02 * low:
            break
    return low
