"""Finds which sightings of a visit are wrong by comparing whole subsets of them.

Sightings that are judged one after the other can mask each other: two that are displaced alike make
the right one between them look wrong. To first order a visit is one linear Gaussian model, in which
each hypothesis (which of the sightings so far are wrong) is a Kalman filter of the robot's pose and
of the camera; the likeliest hypotheses are carried on from sighting to sighting.
"""

import numpy as np
from msgspec.structs import replace

from trigpoint.fusion.model.jitter import Jitter
from trigpoint.native.library import In, Kernel, Out

from .events import Events, window
from .linear import EQUATIONS, Linear

# Accepting a right sighting early improves the score by seventy or so, but only once others agree
# with it. So the score of a partial hypothesis tells little, and as many hypotheses are carried on
# as six sightings have subsets.
_MOST = 64
_MOST_TOLD = 3
_REAL = np.float64
_LIKELIEST = Kernel(
    "tp_likeliest_wrong",
    *EQUATIONS,
    *(In(_REAL, ("m", "d", "d")), In(_REAL, (6,))),
    *(float, float),
    *(Out(_REAL, ("k",)), Out(np.bool_, ("k", "n"))),
)


def likeliest_wrong(
    linear: Linear, jitter: Jitter | None, events: Events
) -> list[tuple[bool, ...]]:
    """The likeliest sets of wrong parts of a visit, as n flags each, best first.

    `jitter`: how far the robot's pose in each picture deviates from what odometry says.
    """
    if jitter is not None:
        linear = replace(linear, own=linear.own + np.diag(jitter.variances))
    scores, flags = np.empty(_MOST), np.empty((_MOST, len(linear.parts)), dtype=bool)
    kept = _LIKELIEST(
        *linear.equations,
        *(linear.spread, events.room_variances, events.wrong_limit, events.pose_score),
        *(scores, flags),
    )
    near = scores[:kept] < scores[0] + window()
    return [tuple(row) for row in flags[:kept][near][:_MOST_TOLD].tolist()]
