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
from scipy.linalg import block_diag
from scipy.optimize import minimize
from scipy.special import chdtri

from trigpoint.fusion.model.jitter import Jitter
from trigpoint.geometry.rotation import Array

from .budget import Budget
from .linear import Linear

# One session in a thousand, of noise as stated, thinks otherwise.
_SIGNIFICANCE = 1e-3
# What a floor or a mast does where nothing is known of it: 0.3° and a millimetre (medians of an
# exponential prior), and odometry within a factor of e, slip of e².
_TILT = math.radians(0.3)
_SWAY = 1e-3
# The slope of floors changes over a metre, within a factor of e.
_LENGTH = 1.0
_LOG_LENGTH = 1.0
_LOG_ODOMETRY = 1.0
_LOG_SLIP = 2.0
_FREE = 1e3
_LEAST = 1e-3  # of these medians: nothing


@dataclass(frozen=True, slots=True)
class _Part:
    """What may be learnt, by the logarithm of its ratio to `middle`: from `start`, within
    `bounds`."""

    middle: float
    start: float
    bounds: tuple[float, float]


_PARTS = {
    "tilt": _Part(_TILT, -1.0, (math.log(_LEAST), 3.0)),
    "sway": _Part(_SWAY, -1.0, (math.log(_LEAST), 3.0)),
    "length": _Part(_LENGTH, 0.0, (-3.0, 3.0)),
    "odometry": _Part(1.0, 0.3, (-2.0, 2.0)),
    "slip": _Part(1.0, 0.0, (-3.0, 3.0)),
}
_JITTER, _ODOMETRY = ("tilt", "sway"), ("odometry", "slip")
_FLOOR = (*_JITTER, "length")
# Where the likelihood changes by less than this share, it tells nothing more.
_FLAT = 1e-6
_ROUNDING = 1e-12
_SAME = 3  # digits of a metre: a robot stands where it stood
_MOST_STEPS = 20


@dataclass(frozen=True, slots=True)
class Noise:
    """`tilt` (rad) and `sway` (m): standard deviations, in each picture, of the robot's turn about
    and its shift along each axis; `length` (m): over which a floor's slope changes, 0: it tilts
    anew in each picture; `odometry`: by what its stated sigmas are multiplied; `slip`: by what the
    slip of a robot that turns is, which nobody states."""

    tilt: float = 0.0
    sway: float = 0.0
    length: float = 0.0
    odometry: float = 1.0
    slip: float = 1.0

    @property
    def jitter(self) -> Jitter | None:
        """How the robot stands otherwise in a picture; None where it does not."""
        if self.tilt <= 0 and self.sway <= 0:
            return None
        tilt, sway = max(self.tilt, _LEAST * _TILT), max(self.sway, _LEAST * _SWAY)
        return Jitter(sway, tilt, self.length)


STATED = Noise()
# What a decision must survive where a session does not tell.
PESSIMISTIC = Noise(tilt=_TILT, sway=_SWAY, odometry=2.0, slip=2.0)


def misfit(visit: Linear, noise: Noise) -> float:
    """-2 ln of the restricted likelihood of a visit, up to a constant."""
    jitter, own, prior, by_unknowns = noise.jitter, visit.own, visit.prior, visit.by_unknowns
    value = 0.0
    if jitter is not None:
        variances = jitter.variances.copy()
        if jitter.length > 0:
            by_floor, information = _floor(visit, jitter)
            by_unknowns = np.concatenate([by_unknowns, by_floor], axis=-1)
            prior = np.asarray(block_diag(prior, information))
            value -= float(np.linalg.slogdet(information)[1])
            variances[3:5] = 0.0
        own = own + np.diag(variances)
    root = np.linalg.cholesky(own)
    shifts = np.linalg.solve(root, visit.shifts[..., None])[..., 0].reshape(-1)
    by = np.linalg.solve(root, by_unknowns).reshape(len(shifts), -1)
    spread = noise.odometry**2 * visit.by_odometry + noise.slip**2 * visit.by_slip
    step_root = np.linalg.cholesky(spread)
    steps = np.linalg.solve(step_root, visit.steps[..., None])[..., 0].reshape(-1)
    by_steps = np.linalg.solve(step_root, visit.steps_by_unknowns)
    by_steps = by_steps.reshape(len(steps), -1)
    by_steps = np.pad(by_steps, ((0, 0), (0, by.shape[1] - by_steps.shape[1])))
    rows = np.vstack([by, by_steps])
    right = np.concatenate([shifts, steps])
    normal = rows.T @ rows + prior
    scale = 1 / np.sqrt(np.diagonal(normal))
    # What nothing determines but odometry that may be anyhow is at the edge of what a number holds.
    factor = np.linalg.cholesky(normal * scale[:, None] * scale + _ROUNDING * np.eye(len(scale)))
    pull = np.linalg.solve(factor, scale * (rows.T @ right))
    value += right @ right - pull @ pull
    value += 2 * np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)))
    value += 2 * np.sum(np.log(np.diagonal(step_root, axis1=1, axis2=2)))
    value += 2 * np.sum(np.log(np.diagonal(factor)) - np.log(scale))
    return float(value)


def _floor(visit: Linear, jitter: Jitter) -> tuple[Array, Array]:
    """What the floor's tilt (2) where a robot stood does to its parts, (n, 6, t), and the
    information (t, t) on it, of a Gaussian process in the plane."""
    places, place = np.unique(visit.places.round(_SAME), axis=0, return_inverse=True)
    by_floor = np.zeros((len(place), 6, len(places), 2))
    by_floor[np.arange(len(place)), 3:5, place] = np.eye(2)
    apart = np.linalg.norm(places[:, None] - places, axis=-1)
    information = np.linalg.inv(np.exp(-apart / jitter.length))
    return by_floor.reshape(len(place), 6, -1), np.kron(information, np.eye(2) / jitter.tilt**2)


def learn(
    visits: list[Linear], budget: Budget | None = None, *, planar: bool = True
) -> Noise | None:
    """The noise that these visits show; None where they are too few to show any, or the budget is
    spent. A robot in space may stand anyhow by what it drives: None too, unless its noise is
    clearly not as stated."""
    budget = budget if budget is not None else Budget()
    freedom = sum(v.shifts.size + v.steps.size - v.by_unknowns.shape[2] for v in visits)
    if freedom < _LEAST_FREEDOM or budget.is_spent:
        return None
    if not planar:
        stated = _likeliest(visits, budget, STATED)
        other = _likeliest(visits, budget, STATED, (*_JITTER, *_ODOMETRY))
        if stated[1] - other[1] < chdtri(4, _SIGNIFICANCE):
            return None
        return Noise(*map(in_steps, astuple(other[0])))
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
        prior = 2 * math.log(2) * (noise.tilt / _TILT + noise.sway / _SWAY)
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


# Noise is told in such steps of its logarithm: what is known finer changes nothing, and what was
# worked out by it can be kept when more pictures come in.
_STEP = 0.1


def in_steps(value: float) -> float:
    """A positive number, rounded to a tenth."""
    return math.exp(round(math.log(value) / _STEP) * _STEP) if value > 0 else value


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
