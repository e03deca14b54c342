"""How far each part of a visit is from where all others predict it, to first order."""

import numpy as np

from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import symmetric

from .linear import Linear


def innovations(visit: Linear, used: np.ndarray, room: Array) -> tuple[Array, Array]:
    """Return the innovation (n, 6) of each part, given odometry and all others that are `used`
    (n,), and its covariance (n, 6, 6). `room` (6,): the variances of the camera's pose, of which
    nothing else is known."""
    by_steps, by_parts = _dense(visit)
    weighted = np.swapaxes(np.linalg.solve(visit.spread, by_steps), 1, 2)
    prior = visit.prior + np.pad(1 / room, (0, len(visit.prior) - len(room)))
    information = np.diag(np.pad(prior, (by_parts.shape[2] - len(prior), 0)))
    information += np.sum(weighted @ by_steps, axis=0)
    pull = np.sum(weighted @ visit.steps[..., None], axis=0)
    weighted = used[:, None, None] * np.swapaxes(np.linalg.solve(visit.own, by_parts), 1, 2)
    own, asked = weighted @ by_parts, weighted @ visit.shifts[..., None]
    covariance = np.linalg.inv(information + np.sum(own, axis=0) - own)
    predicted = by_parts @ covariance @ (pull + np.sum(asked, axis=0) - asked)
    spread = visit.own + by_parts @ covariance @ np.swapaxes(by_parts, 1, 2)
    return visit.shifts - predicted[..., 0], spread


def _dense(visit: Linear) -> tuple[Array, Array]:
    """Return the coefficients of all unknowns in each step (m, d, u) and in each part (n, 6, u)."""
    steps, d = visit.steps.shape
    by_steps = np.zeros((steps, d, steps + 1, d))  # the first node is held
    by_steps[range(steps), :, range(steps)] = visit.by_earlier
    by_steps[range(steps), :, range(1, steps + 1)] = visit.by_later
    parts = len(visit.parts)
    by_parts = np.zeros((parts, 6, steps + 1, d))
    by_parts[range(parts), :, visit.nodes] = visit.by_robot
    return (
        np.concatenate([by_steps[:, :, 1:].reshape(steps, d, -1), visit.steps_by_others], axis=2),
        np.concatenate([by_parts[:, :, 1:].reshape(parts, 6, -1), visit.by_others], axis=2),
    )


def surprise(error: Array, spread: Array) -> tuple[Array, Array]:
    """νᵀS⁻¹ν and ln |S| of innovations ν (n, 6) with covariances S (n, 6, 6)."""
    spread = symmetric(spread)
    pulled = np.linalg.solve(spread, error[..., None])[..., 0]
    return np.sum(error * pulled, axis=1), np.linalg.slogdet(spread)[1]
