"""Finds which sightings of a visit are wrong by comparing whole subsets of them.

Sightings that are judged one after the other can mask each other: two that are displaced alike make
the right one between them look wrong. To first order a visit is one linear Gaussian model, in which
each hypothesis (which of the sightings so far are wrong) is a Kalman filter; the likeliest
hypotheses are carried on from sighting to sighting.
"""

import numpy as np

from trigpoint.fusion.model.jitter import Jitter
from trigpoint.geometry.rotation import Array

from .events import Events, window
from .linear import Linear

# Accepting a right sighting early improves the score by seventy or so, but only once others agree
# with it. So the score of a partial hypothesis tells little, and as many hypotheses are carried on
# as six sightings have subsets.
_MOST = 64
_MOST_TOLD = 3


def likeliest_wrong(
    linear: Linear, jitter: Jitter | None, events: Events
) -> list[tuple[bool, ...]]:
    """The likeliest sets of wrong parts of a visit, as n flags each, best first.

    `jitter`: how far the robot's pose in each picture deviates from what odometry says.
    """
    mean, covariance = _before(linear, events)
    means, covariances = mean[None], covariance[None]
    scores, flags = np.zeros(1), np.zeros((1, 0), dtype=bool)
    limit = events.wrong_limit
    for shift, own, by in zip(linear.shifts, linear.own, linear.by_unknowns, strict=True):
        own = own if jitter is None else own + np.diag(jitter.variances)
        gain = covariances @ by.T
        spread = by @ gain + own
        error = shift - means @ by.T
        inverse = np.linalg.inv(spread)
        surprise = np.einsum("bi,bij,bj->b", error, inverse, error)
        room = np.minimum(np.linalg.slogdet(spread)[1], events.pose_score)
        weighted = gain @ inverse
        right_means = means + (weighted @ error[..., None])[..., 0]
        right = covariances - weighted @ np.swapaxes(gain, 1, 2)
        both = np.concatenate([scores + surprise + room, scores + limit])
        kept = np.argsort(both, kind="stable")[:_MOST]
        means = np.concatenate([right_means, means])[kept]
        covariances = np.concatenate([right, covariances])[kept]
        is_wrong = kept >= len(scores)
        flags = np.column_stack([flags[kept % len(scores)], is_wrong])
        scores = both[kept]
    near = scores < scores[0] + window()
    return [tuple(row) for row in flags[near][:_MOST_TOLD].tolist()]


def _before(linear: Linear, events: Events) -> tuple[Array, Array]:
    """Prior mean (u,) and covariance (u, u) of the unknowns by odometry and priors, with the camera
    anywhere in the room."""
    information = linear.prior.copy()
    information[linear.camera, linear.camera] += 1 / events.room_variances
    weighted = np.swapaxes(linear.steps_by_unknowns, 1, 2) @ np.linalg.inv(linear.spread)
    information += (weighted @ linear.steps_by_unknowns).sum(axis=0)
    pull = (weighted @ linear.steps[..., None])[..., 0].sum(axis=0)
    covariance = np.linalg.inv(information)
    return covariance @ pull, covariance
