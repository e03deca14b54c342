"""Finds which sightings of a visit are wrong by comparing whole subsets of them.

Sightings that are judged one after the other can mask each other: two that are displaced alike make
the right one between them look wrong. To first order a visit is one linear Gaussian model, in which
each hypothesis (which of the sightings so far are wrong) is a Kalman filter; the likeliest
hypotheses are carried on from sighting to sighting.
"""

import numpy as np

from trigpoint.fusion.model.jitter import Jitter
from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In, Kernel, Out

from .events import Events, window
from .linear import Linear

# Accepting a right sighting early improves the score by seventy or so, but only once others agree
# with it. So the score of a partial hypothesis tells little, and as many hypotheses are carried on
# as six sightings have subsets.
_MOST = 64
_MOST_TOLD = 3
_REAL = np.float64
_LIKELIEST = Kernel(
    "tp_likeliest_wrong",
    In(_REAL, ("u",)),
    In(_REAL, ("u", "u")),
    In(_REAL, ("n", 6)),
    In(_REAL, ("n", 6, 6)),
    In(_REAL, ("n", 6, "u")),
    float,
    float,
    Out(_REAL, ("m",)),
    Out(np.bool_, ("m", "n")),
)


def likeliest_wrong(
    linear: Linear, jitter: Jitter | None, events: Events
) -> list[tuple[bool, ...]]:
    """The likeliest sets of wrong parts of a visit, as n flags each, best first.

    `jitter`: how far the robot's pose in each picture deviates from what odometry says.
    """
    mean, covariance = _before(linear, events)
    own = linear.own if jitter is None else linear.own + np.diag(jitter.variances)
    count = len(linear.parts)
    scores, flags = np.empty(_MOST), np.empty((_MOST, count), dtype=bool)
    kept = _LIKELIEST(
        mean,
        np.ascontiguousarray(covariance),
        *(np.ascontiguousarray(each) for each in (linear.shifts, own, linear.by_unknowns)),
        events.wrong_limit,
        events.pose_score,
        scores,
        flags,
    )
    near = scores[:kept] < scores[0] + window()
    return [tuple(row) for row in flags[:kept][near][:_MOST_TOLD].tolist()]


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
