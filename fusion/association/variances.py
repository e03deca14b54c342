"""Learns from a session how noisy it really is.

The site file states the noise of odometry, and every sighting that of its corners; but floors tilt,
masts sway, and stated sigmas are wrong. Two kinds of evidence tell the noise, and neither needs to
know where anything is:

- the residual of a single board's best fit tells how noisy corners are (`corner_scale`);
- the disagreement of one visit's pictures about one camera tells how far the robot tilts and the
  target sways in each picture, and how much noisier odometry is than stated (`learn`): variance
  components by restricted maximum likelihood (Patterson and Thompson, 1971).

What does not differ significantly from what is stated stays as stated. But nobody states how a
floor slopes, and pictures that were taken near each other hardly tell: of that the mean over its
posterior is taken (`expected_slope`), not the likeliest, which is none.
"""

import math

import numpy as np
from msgspec import Struct
from msgspec.structs import astuple, fields, replace

from trigpoint.fusion.model.jitter import Jitter
from trigpoint.fusion.model.odometry import PLANAR, SPATIAL
from trigpoint.fusion.solver.quasi_newton import least
from trigpoint.geometry.chi_square import chi2_limit
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.samples import median
from trigpoint.native.library import In, Kernel, Out

from .budget import Budget
from .events import Events
from .linear import EQUATIONS, Linear
from .noise import LEAST, LENGTH, STATED, SWAY, TILT, Noise, in_steps, on_a_floor

# The probability with which a session whose noise is as stated is found to differ.
_SIGNIFICANCE = 1e-3
# Priors: the noise of odometry is as stated within a factor of e, slip within e².
_LOG_LENGTH = 1.0
_LOG_ODOMETRY = 1.0
_LOG_SLIP = 2.0
_FREE = 1e3
_REAL = np.float64
_STEADY = Jitter(0.0, 0.0)
_MISFIT = Kernel(
    "tp_misfit",
    *EQUATIONS,
    In(_REAL, ("n", 3)),
    *(In(_REAL, ("m", "d", "d")), In(_REAL, ("m", "d", "d")), In(_REAL, ("m", "d", "d"))),
    *(In(_REAL, (6,)), float, float, float, float),
    *(Out(_REAL, (1,)), Out(_REAL, (5,)), Out(_REAL, ("m",))),
)


class _Part(Struct, frozen=True):
    """A parameter of the noise that may be learnt, as the logarithm of its ratio to `middle`:
    the search begins at `start` and stays within `bounds`."""

    middle: float
    start: float
    bounds: tuple[float, float]


_PARTS = {
    "tilt": _Part(TILT, -1.0, (math.log(LEAST), 3.0)),
    "sway": _Part(SWAY, -1.0, (math.log(LEAST), 3.0)),
    "length": _Part(LENGTH, 0.0, (-3.0, 3.0)),
    "odometry": _Part(1.0, 0.3, (-2.0, 2.0)),
    "slip": _Part(1.0, 0.0, (-3.0, 3.0)),
}
_NAMES = [field.name for field in fields(Noise)]
_JITTER, _ODOMETRY = ("tilt", "sway"), ("odometry", "slip")
_FLOOR = (*_JITTER, "length")
# The search ends where the likelihood changes by less than this share.
_FLAT = 1e-7
_MOST_STEPS = 50
# Slopes by which an expected one is summed, in units of the prior's; one that is below this share
# of the prior's is told to be none: what is left of it costs more than it gives (decisions/0676).
_SLOPES = np.exp(np.arange(-4.0, 2.1, 0.5))
_LEAST_SLOPE = 0.25


class Misfit(Struct, frozen=True):
    """How improbable a visit is under a noise model: `value`, -2 ln of its restricted likelihood up
    to a constant, infinite where the visit determines none; `by_noise` (5,): its derivatives by the
    logarithms of the model's numbers, in their order; `by_step` (m,): by how much χ² is lower
    without each step."""

    value: float
    by_noise: Array
    by_step: Array


def misfit(visit: Linear, noise: Noise) -> Misfit:
    """The misfit of a visit under a noise model."""
    jitter = noise.jitter or _STEADY
    value, by_noise, by_step = np.empty(1), np.empty(5), np.empty(len(visit.steps))
    is_determined = _MISFIT(
        *visit.equations,
        *(visit.places, visit.by_odometry, visit.by_slip, visit.broken),
        *(jitter.variances, jitter.tilt, jitter.length, noise.odometry, noise.slip),
        *(value, by_noise, by_step),
    )
    if not is_determined:
        return Misfit(np.inf, np.zeros(5), np.zeros(len(visit.steps)))
    return Misfit(float(value[0]), by_noise, by_step)


def interrupted(visit: Linear, noise: Noise, events: Events) -> tuple[Linear, int]:
    """The visit with those steps broken in which, under this noise, an event (a lift, a moved
    camera) is likelier than so large an error of odometry, and the number of these steps."""
    before, count = misfit(visit, noise), 0
    while count < len(visit.steps):
        other = _broken(visit, int(np.argmax(before.by_step)), events)
        after = misfit(other, noise)
        if not after.value + events.event_score < before.value:
            break
        visit, before, count = other, after, count + 1
    return visit, count


def _broken(visit: Linear, step: int, events: Events) -> Linear:
    """The visit with a robot that may be anywhere in the room after a step."""
    broken = visit.broken.copy()
    free = PLANAR if broken.shape[-1] == len(PLANAR) else SPATIAL
    broken[step] += np.diag(events.room_variances[free])
    return replace(visit, broken=broken)


def learn(
    visits: list[Linear], events: Events, budget: Budget | None = None, *, planar: bool = True
) -> tuple[Noise | None, ...]:
    """The noise that these visits show, with alternatives, the least first; None where they are too
    few to show any, or the budget is spent. A robot in space may take any attitude as it drives:
    None too, unless its noise clearly differs from the stated.

    An event in one visit must not pass for noise in all: where the noise learnt from the other
    visits makes an event in some of its steps likelier than such errors of odometry, the noise
    learnt without those steps comes first.
    """
    budget = budget if budget is not None else Budget()
    visits = [visit for visit in visits if math.isfinite(misfit(visit, STATED).value)]
    first = found = _learnt(visits, budget, planar=planar)
    broken_off = [_broken_off(visit, events) for visit in visits]
    for order in sorted(range(len(visits)), key=lambda n: -broken_off[n]):
        if broken_off[order] <= 0 or budget.is_spent:
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
    likeliest = (first,) if found == first else (found, first)
    if planar and any(noise and noise.tilt == 0 for noise in likeliest):
        slope = expected_slope(visits, events.priors.floor_tilt, budget)
        return tuple(on_a_floor(n, slope) if n and n.tilt == 0 else n for n in likeliest)
    return likeliest


def expected_slope(visits: list[Linear], prior: float, budget: Budget) -> float:
    """The root mean square (rad) of the floor's slope by its posterior: `prior` where these visits
    tell nothing, 0 where they show that there is hardly any. As likely as not a floor is flat; else
    its slope is exponentially distributed."""
    if prior <= 0:
        return 0.0
    flat = Noise(odometry=_FREE, slip=_FREE)
    slopes = prior * _SLOPES
    floors = [on_a_floor(flat, slope) for slope in [0.0, *slopes]]
    costs = np.array([_misfit(visits, floor, budget)[0] for floor in floors])
    density = _SLOPES * np.exp(-_SLOPES)
    weights = np.array([1.0, *density / density.sum()]) * np.exp((costs.min() - costs) / 2)
    slope = math.sqrt(weights[1:] @ slopes**2 / weights.sum())
    return in_steps(slope) if slope > _LEAST_SLOPE * prior else 0.0


def _broken_off(visit: Linear, events: Events) -> float:
    """By how much events in a visit improve its score under the stated noise."""
    broken, count = interrupted(visit, STATED, events)
    if not count:
        return 0.0
    gain = misfit(visit, STATED).value - misfit(broken, STATED).value
    return gain - events.happened(count)


def _learnt(visits: list[Linear], budget: Budget, *, planar: bool) -> Noise | None:
    freedom = sum(v.shifts.size - len(v.prior) for v in visits)  # each step determines a pose
    if freedom < _LEAST_FREEDOM or budget.is_spent:
        return None
    if not planar:
        stated = _likeliest(visits, budget, STATED)
        one = min(
            (_likeliest(visits, budget, STATED, free) for free in (_JITTER, _ODOMETRY)), key=_cost
        )
        if stated[1] - one[1] < chi2_limit(4, _SIGNIFICANCE):
            return None
        both = _likeliest(visits, budget, STATED, (*_JITTER, *_ODOMETRY))
        found = both if one[1] - both[1] > chi2_limit(2, _SIGNIFICANCE) else one
        return Noise(*map(in_steps, astuple(found[0])))
    # How the robot tilts and rises shows without odometry, which is left free here so that what its
    # model lacks is not taken for a sway of the target.
    loose = Noise(odometry=_FREE, slip=_FREE)
    jittery = min(
        (_likeliest(visits, budget, loose, free) for free in (_JITTER, _FLOOR)), key=_cost
    )
    steady = _likeliest(visits, budget, loose)
    if steady[1] - jittery[1] < chi2_limit(2, _SIGNIFICANCE):
        jittery = steady
    start = replace(jittery[0], odometry=1.0, slip=1.0)
    stated = _likeliest(visits, budget, start)
    other = _likeliest(visits, budget, start, _ODOMETRY)
    found = other[0] if stated[1] - other[1] > chi2_limit(2, _SIGNIFICANCE) else start
    return Noise(*map(in_steps, astuple(found)))


def _cost(found: tuple[Noise, float]) -> float:
    return found[1]


# Fewer degrees of freedom leave a variance uncertain by more than a factor of two.
_LEAST_FREEDOM = 24


def _likeliest(
    visits: list[Linear], budget: Budget, base: Noise, free: tuple[str, ...] = ()
) -> tuple[Noise, float]:
    """The noise of greatest posterior with the parts `free` of `base` varied, and -2 ln of that
    posterior."""
    parts = [_PARTS[name] for name in free]
    chosen = [_NAMES.index(name) for name in free]

    def noise_of(x: Array) -> Noise:
        values = [part.middle * math.exp(one) for part, one in zip(parts, x, strict=True)]
        return replace(base, **dict(zip(free, values, strict=True)))

    def cost(x: Array) -> tuple[float, Array]:
        noise = noise_of(x)
        value, by_noise = _misfit(visits, noise, budget)
        prior, by_prior = _prior(noise)
        return value + prior, (by_noise + by_prior)[chosen]

    start = np.array([part.start for part in parts])
    if not free:
        return base, cost(start)[0]
    bounds = np.array([part.bounds for part in parts])
    found, value = least(cost, start, bounds=bounds, flat=_FLAT, most_steps=_MOST_STEPS)
    return noise_of(found), value


def _misfit(visits: list[Linear], noise: Noise, budget: Budget) -> tuple[float, Array]:
    """The misfit of all visits, and its derivatives (5,) by the logarithms of the model's
    numbers."""
    value, by_noise = 0.0, np.zeros(5)
    for visit in visits:
        floor = 2 * len(visit.parts) if noise.length > 0 else 0
        budget.spend_learning(steps=len(visit.steps), shared=len(visit.prior) + floor)
        more = misfit(visit, noise)
        value, by_noise = value + more.value, by_noise + more.by_noise
    return value, by_noise


def _prior(noise: Noise) -> tuple[float, Array]:
    """-2 ln of the prior probability of a noise model, and its derivatives (5,) by the logarithms
    of the model's numbers."""
    jitter = 2 * math.log(2) * np.array([noise.tilt / TILT, noise.sway / SWAY])
    length = math.log(noise.length / LENGTH) / _LOG_LENGTH if noise.length > 0 else 0.0
    odometry, slip = math.log(noise.odometry) / _LOG_ODOMETRY, math.log(noise.slip) / _LOG_SLIP
    value = jitter.sum() + length**2 + odometry**2 + slip**2
    by_logs = 2 * length / _LOG_LENGTH, 2 * odometry / _LOG_ODOMETRY, 2 * slip / _LOG_SLIP
    return float(value), np.array([*jitter, *by_logs])


# The scatter of one board of twenty corners or so is known to a third; over all boards, a
# difference of so many of the sigmas that remain is no chance.
_SCATTER_SIGMA = 0.3
_BEYOND_CHANCE = 5.0


def corner_scale(scatters: list[float]) -> float:
    """The factor on the corners' stated sigma, from the scatters of single boards; 1 where they do
    not differ significantly. Their median is robust against what is no board of ours."""
    if not scatters:
        return 1.0
    middle = max(median(scatters), 1e-6)
    if abs(middle - 1) < _BEYOND_CHANCE * _SCATTER_SIGMA / math.sqrt(len(scatters)):
        return 1.0
    return in_steps(math.sqrt(middle))
