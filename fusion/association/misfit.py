"""How improbable a visit is under a noise model, and in which of its steps an event is likelier."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from trigpoint.fusion.model.jitter import Jitter
from trigpoint.fusion.model.odometry import PLANAR, SPATIAL
from trigpoint.geometry.rotation import Array

from .events import Events
from .linear import Linear
from .noise import Noise

_ROUNDING = 1e-12
_SAME = 3  # decimals of a metre, to which positions of one place agree


@dataclass(frozen=True, slots=True)
class _Whitened:
    """A visit's equations, whitened: `rows` (n, u) and `right` (n,), those of the steps last;
    `prior` (u, u): information on the unknowns; `spread`: Σ ln |covariance| of what was whitened
    and of the floor's tilt."""

    rows: Array
    right: Array
    prior: Array
    spread: float

    def solved(self) -> tuple[Array, Array, Array]:
        """The scale (u,) and Cholesky factor (u, u) of the scaled normal equations, and their right
        side, scaled and solved by that factor, (u,)."""
        normal = self.rows.T @ self.rows + self.prior
        scale = 1 / np.sqrt(np.diagonal(normal))
        # An unknown that nothing but nearly free odometry determines is at the limit of double
        # precision.
        factor = np.linalg.cholesky(
            normal * scale[:, None] * scale + _ROUNDING * np.eye(len(scale))
        )
        return scale, factor, np.linalg.solve(factor, scale * (self.rows.T @ self.right))


def misfit(visit: Linear, noise: Noise) -> float:
    """-2 ln of a visit's restricted likelihood under a noise model, up to a constant."""
    whitened = _whitened(visit, noise)
    scale, factor, pull = whitened.solved()
    value = whitened.right @ whitened.right - pull @ pull + whitened.spread
    return float(value + 2 * np.sum(np.log(np.diagonal(factor)) - np.log(scale)))


def interrupted(visit: Linear, noise: Noise, events: Events) -> tuple[Linear, int]:
    """The visit with those steps broken in which, under this noise, an event (a lift, a moved
    camera) is likelier than so large an error of odometry, and the number of these steps."""
    before, count = misfit(visit, noise), 0
    while count < len(visit.steps):
        other = _broken(visit, _worst_step(visit, noise), events)
        after = misfit(other, noise)
        if after + events.event_score >= before:
            break
        visit, before, count = other, after, count + 1
    return visit, count


def _broken(visit: Linear, step: int, events: Events) -> Linear:
    """The visit with a robot that may be anywhere in the room after a step."""
    broken = visit.broken.copy()
    free = PLANAR if broken.shape[-1] == len(PLANAR) else SPATIAL
    broken[step] += np.diag(events.room_variances[free])
    return replace(visit, broken=broken)


def _worst_step(visit: Linear, noise: Noise) -> int:
    """The step whose removal lowers χ² most."""
    whitened = _whitened(visit, noise)
    scale, factor, pull = whitened.solved()
    rows = whitened.rows * scale
    left = whitened.right - rows @ np.linalg.solve(factor.T, pull)
    by_factor = np.linalg.solve(factor, rows.T)
    m, d = visit.steps.shape
    left, known = left[-m * d :].reshape(m, d), by_factor[:, -m * d :].reshape(-1, m, d)
    leverage = np.einsum("umi,umj->mij", known, known)
    room = np.eye(d) * (1 + _ROUNDING) - leverage
    saved = np.linalg.solve(room, left[..., None])[..., 0]
    return int(np.argmax(np.sum(left * saved, axis=1)))


def _whitened(visit: Linear, noise: Noise) -> _Whitened:
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
    spread = noise.odometry**2 * visit.by_odometry + noise.slip**2 * visit.by_slip + visit.broken
    step_root = np.linalg.cholesky(spread)
    steps = np.linalg.solve(step_root, visit.steps[..., None])[..., 0].reshape(-1)
    by_steps = np.linalg.solve(step_root, visit.steps_by_unknowns)
    by_steps = by_steps.reshape(len(steps), -1)
    by_steps = np.pad(by_steps, ((0, 0), (0, by.shape[1] - by_steps.shape[1])))
    rows = np.vstack([by, by_steps])
    right = np.concatenate([shifts, steps])
    value += 2 * np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)))
    value += 2 * np.sum(np.log(np.diagonal(step_root, axis1=1, axis2=2)))
    return _Whitened(rows, right, prior, float(value))


def _floor(visit: Linear, jitter: Jitter) -> tuple[Array, Array]:
    """The parts' derivatives (n, 6, t) by the floor's tilt, two unknowns for each place where the
    robot stood, and the prior information (t, t) on it, that of a Gaussian process in the plane."""
    places, place = np.unique(visit.places.round(_SAME), axis=0, return_inverse=True)
    by_floor = np.zeros((len(place), 6, len(places), 2))
    by_floor[np.arange(len(place)), 3:5, place] = np.eye(2)
    apart = np.linalg.norm(places[:, None] - places, axis=-1)
    information = np.linalg.inv(np.exp(-apart / jitter.length))
    return by_floor.reshape(len(place), 6, -1), np.kron(information, np.eye(2) / jitter.tilt**2)
