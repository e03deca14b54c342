"""How noisy a session really is, learnt from it where it tells.

The site file states the noise of odometry, every sighting that of its corners; floors tilt, masts
sway, and stated sigmas are wrong. Two kinds of evidence tell, and neither asks where anything is:

- what a single board's best fit leaves over tells how noisy corners are (`corner_scale`);
- how the pictures of one visit disagree about one camera tells how far the robot tilts and the
  target sways in each picture, and how much noisier odometry is than stated (`learn`): variance
  components of greatest restricted likelihood (Patterson and Thompson, 1971).

What is not significantly otherwise than stated stays as stated.
"""

import math
from dataclasses import astuple, dataclass, replace

import numpy as np
from scipy.optimize import minimize
from scipy.special import chdtri

from trigpoint.geometry.rotation import Array

from .budget import Budget
from .events import Events
from .linear import Linear
from .misfit import interrupted, misfit
from .noise import LEAST, STATED, SWAY, TILT, Noise, in_steps

# One session in a thousand, of noise as stated, thinks otherwise.
_SIGNIFICANCE = 1e-3
# The slope of floors changes over a metre, within a factor of e; odometry is within a factor of e,
# slip of e².
_LENGTH = 1.0
_LOG_LENGTH = 1.0
_LOG_ODOMETRY = 1.0
_LOG_SLIP = 2.0
_FREE = 1e3


@dataclass(frozen=True, slots=True)
class _Part:
    """What may be learnt, by the logarithm of its ratio to `middle`: from `start`, within
    `bounds`."""

    middle: float
    start: float
    bounds: tuple[float, float]


_PARTS = {
    "tilt": _Part(TILT, -1.0, (math.log(LEAST), 3.0)),
    "sway": _Part(SWAY, -1.0, (math.log(LEAST), 3.0)),
    "length": _Part(_LENGTH, 0.0, (-3.0, 3.0)),
    "odometry": _Part(1.0, 0.3, (-2.0, 2.0)),
    "slip": _Part(1.0, 0.0, (-3.0, 3.0)),
}
_JITTER, _ODOMETRY = ("tilt", "sway"), ("odometry", "slip")
_FLOOR = (*_JITTER, "length")
# Where the likelihood changes by less than this share, it tells nothing more.
_FLAT = 1e-6
_MOST_STEPS = 20


def learn(
    visits: list[Linear], events: Events, budget: Budget | None = None, *, planar: bool = True
) -> tuple[Noise | None, ...]:
    """What the noise that these visits show may be, the least first; None where they are too few to
    show any, or the budget is spent. A robot in space may stand anyhow by what it drives: None too,
    unless its noise is clearly not as stated.

    What happened in one visit is sooner no noise of all: where its steps are likelier broken by an
    event, by the noise of all the others, than as far off as they are, the noise without those
    comes first.
    """
    budget = budget if budget is not None else Budget()
    first = found = _learnt(visits, budget, planar=planar)
    for order in sorted(range(len(visits)), key=lambda n: -_broken_off(visits[n], events)):
        if _broken_off(visits[order], events) <= 0 or budget.is_spent:
            break
        others = _learnt(visits[:order] + visits[order + 1 :], budget, planar=planar)
        broken, count = interrupted(visits[order], others or STATED, events)
        if not count:
            break
        parted = [*visits[:order], broken, *visits[order + 1 :]]
        other = _learnt(parted, budget, planar=planar)
        gain = (
            _likeliest(visits, budget, found or STATED)[1]
            - _likeliest(parted, budget, other or STATED)[1]
        )
        if gain < events.happened(count):
            break
        visits, found = parted, other
    return (first,) if found == first else (found, first)


def _broken_off(visit: Linear, events: Events) -> float:
    """How much likelier a visit of the stated noise is with events in it."""
    broken, count = interrupted(visit, STATED, events)
    return misfit(visit, STATED) - misfit(broken, STATED) - events.happened(count)


def _learnt(visits: list[Linear], budget: Budget, *, planar: bool) -> Noise | None:
    freedom = sum(v.shifts.size + v.steps.size - v.by_unknowns.shape[2] for v in visits)
    if freedom < _LEAST_FREEDOM or budget.is_spent:
        return None
    if not planar:
        stated = _likeliest(visits, budget, STATED)
        one = min(
            (_likeliest(visits, budget, STATED, free) for free in (_JITTER, _ODOMETRY)), key=_cost
        )
        if stated[1] - one[1] < chdtri(4, _SIGNIFICANCE):
            return None
        both = _likeliest(visits, budget, STATED, (*_JITTER, *_ODOMETRY))
        found = both if one[1] - both[1] > chdtri(2, _SIGNIFICANCE) else one
        return Noise(*map(in_steps, astuple(found[0])))
    # How the robot tilts and rises shows whatever odometry says: that is left free here, so that
    # what its model lacks is not taken for a target that sways.
    loose = Noise(odometry=_FREE, slip=_FREE)
    jittery = min(
        (_likeliest(visits, budget, loose, free) for free in (_JITTER, _FLOOR)), key=_cost
    )
    steady = _likeliest(visits, budget, loose)
    if steady[1] - jittery[1] < chdtri(2, _SIGNIFICANCE):
        jittery = steady
    start = replace(jittery[0], odometry=1.0, slip=1.0)
    stated = _likeliest(visits, budget, start)
    other = _likeliest(visits, budget, start, _ODOMETRY)
    found = other[0] if stated[1] - other[1] > chdtri(2, _SIGNIFICANCE) else start
    return Noise(*map(in_steps, astuple(found)))


def _cost(found: tuple[Noise, float]) -> float:
    return found[1]


# Fewer residuals than these leave a variance open by more than a factor of two.
_LEAST_FREEDOM = 24


def _likeliest(
    visits: list[Linear], budget: Budget, base: Noise, free: tuple[str, ...] = ()
) -> tuple[Noise, float]:
    """The noise of greatest posterior with these parts of `base` free, and -2 ln of it."""
    parts = [_PARTS[name] for name in free]

    def noise_of(x: Array) -> Noise:
        values = [part.middle * math.exp(one) for part, one in zip(parts, x, strict=True)]
        return replace(base, **dict(zip(free, values, strict=True)))

    def cost(x: Array) -> float:
        noise = noise_of(x)
        prior = 2 * math.log(2) * (noise.tilt / TILT + noise.sway / SWAY)
        prior += (math.log(noise.odometry) / _LOG_ODOMETRY) ** 2
        prior += (math.log(noise.slip) / _LOG_SLIP) ** 2
        if noise.length > 0:
            prior += (math.log(noise.length / _LENGTH) / _LOG_LENGTH) ** 2
        for visit in visits:
            budget.spend_learning(unknowns=visit.by_unknowns.shape[2] + 2 * len(visit.places))
        return sum(misfit(visit, noise) for visit in visits) + prior

    start = np.array([part.start for part in parts])
    if not free:
        return base, cost(start)
    options = {"ftol": _FLAT, "eps": 1e-3, "maxiter": _MOST_STEPS}
    bounds = [part.bounds for part in parts]
    found = minimize(cost, start, method="L-BFGS-B", bounds=bounds, options=options)
    return noise_of(found.x), float(found.fun)


# The scatter of one board's twenty corners or so is known to a third; so many times what is left of
# that over all boards is no chance.
_SCATTER_SIGMA = 0.3
_BEYOND_CHANCE = 5.0


def corner_scale(scatters: list[float]) -> float:
    """The factor by which corners scatter otherwise than stated, from those of single boards; the
    median leaves out what is no board of ours."""
    if not scatters:
        return 1.0
    middle = max(float(np.median(scatters)), 1e-6)
    if abs(middle - 1) < _BEYOND_CHANCE * _SCATTER_SIGMA / math.sqrt(len(scatters)):
        return 1.0
    return in_steps(math.sqrt(middle))
