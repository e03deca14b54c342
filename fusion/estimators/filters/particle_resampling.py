"""Weights of particles: effective sample size, low-variance resampling, and small steps of it."""

from collections.abc import Callable

import numpy as np

from trigpoint.geometry.rotation import Array

# How far a copy is drawn from its original, as a share of the spread (Liu and West, «Combined
# parameter and state estimation in simulation-based filtering», 2001).
_APART = 0.3
# Keeps a spread of zero (the map's origin) positive: 0.1 µm and µrad.
_FLOOR_VARIANCE = 1e-14
# Particles that differ by less than this many sigmas of a sighting count as equal for it.
_NARROW = 0.01


def normalised(log_weights: Array) -> Array:
    """Weights (n,) that sum to 1."""
    weights = np.exp(log_weights - log_weights.max())
    return weights / weights.sum()


def effective_sample_size(weights: Array) -> float:
    """1/Σw²: so many equally weighted particles are as informative (Kong, Liu and Wong, 1994)."""
    return float(1 / np.sum(weights**2))


def low_variance_indices(weights: Array, random: np.random.Generator) -> np.ndarray:
    """Indices (n,) by systematic resampling: a particle of weight w comes ⌊nw⌋ or ⌈nw⌉ times
    (Kitagawa, 1996)."""
    positions = (random.random() + np.arange(len(weights))) / len(weights)
    found = np.searchsorted(np.cumsum(weights), positions, "right")
    return np.minimum(found, len(weights) - 1)  # by rounding, the sum may end below the last


def resampled(
    errors: Array, shown: Array, weights: Array, random: np.random.Generator
) -> tuple[Array, np.ndarray]:
    """Equally weighted particles in place of weighted ones: errors (n, D), and the index (n,) of
    the particle whose `shown` each of them took.

    `shown`: (n, k), what the weights depend on, in sigmas. It is resampled; the rest of a particle
    follows by its regression on it, and what does not depend on it stays (Anderson, «A local least
    squares framework for ensemble filtering», 2003), so that a sighting of one camera adds no noise
    to the others. Copies are drawn apart by a Gaussian kernel, and all are moved so that mean and
    covariance of `shown` are exactly the weighted ones.
    """
    values, vectors = np.linalg.eigh(np.cov(shown.T, bias=True))
    wide = values > _NARROW**2
    axes = vectors[:, wide] / np.sqrt(values[wide])
    even = (shown - shown.mean(axis=0)) @ axes  # mean 0 and covariance 1
    mean, covariance = moments(even, weights)
    indices = low_variance_indices(weights, random)
    root = np.linalg.cholesky(covariance + _FLOOR_VARIANCE * np.eye(len(mean)))
    drawn = random.standard_normal(even.shape) @ root.T
    spread = mean + np.sqrt(1 - _APART**2) * (even[indices] - mean) + _APART * drawn
    moved = mean + standardised(spread) @ root.T - even
    return errors + moved @ (even.T @ errors) / len(errors), indices


def regression(values: Array, on: Array) -> Array:
    """Coefficients (D, k) of the linear regression of values (n, k) on others (n, D) in this
    sample; 0 in directions in which the others do not vary."""
    centred = on - on.mean(axis=0)
    scale = 1 / np.maximum(np.sqrt(np.mean(centred**2, axis=0)), 1e-12)
    centred = centred * scale
    inverse = np.linalg.pinv(centred.T @ centred, rcond=1e-9, hermitian=True)
    return scale[:, None] * (inverse @ (centred.T @ (values - values.mean(axis=0))))


def standardised(values: Array) -> Array:
    """Values (n, k), shifted and scaled together to mean 0 and covariance 1."""
    centred = values - values.mean(axis=0)
    covariance = centred.T @ centred / len(values)
    root = np.linalg.cholesky(covariance + _FLOOR_VARIANCE * np.eye(values.shape[1]))
    return np.linalg.solve(root, centred.T).T


def independent_draws(errors: Array, count: int, random: np.random.Generator) -> Array:
    """Standard normal draws (n, count) that have mean 0, covariance 1 and no correlation with the
    errors (n, D) in this very sample."""
    draws = random.standard_normal((len(errors), count))
    return standardised(draws - (errors - errors.mean(axis=0)) @ regression(draws, errors))


def moments(errors: Array, weights: Array) -> tuple[Array, Array]:
    """Weighted mean (k,) and covariance (k, k) of errors (n, k)."""
    mean = weights @ errors
    apart = errors - mean
    return mean, (apart * weights[:, None]).T @ apart


def largest_share(log_likelihood: Array, most: float) -> float:
    """The largest exponent, up to `most`, of a likelihood that keeps half of n particles effective.

    A sighting that is far more informative than the particles is taken in such shares, with
    resampling in between (tempering: Neal, «Annealed importance sampling», 2001).
    """

    def is_kept(share: float) -> bool:
        weights = normalised(share * log_likelihood)
        return effective_sample_size(weights) >= len(weights) / 2

    return most if is_kept(most) else _bisected(is_kept, most)


def _bisected(is_kept: Callable[[float], bool], most: float) -> float:
    low, high = 0.0, most
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if is_kept(middle) else (low, middle)
        if low > 0 and high - low < 0.02 * low:
            break
    return low
