"""Fits planes and lenses to the corners of a face.

A weak prior towards no lens, and towards one in the picture's middle, keeps noise from looking like
one.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from trigpoint.geometry.rotation import Array

from .bend import Bend
from .planar_fit import HORIZON, PlanarFit, shares

_RADIAL_PRIOR = 0.5  # of each coefficient, at the corner of the picture
_PRIOR_SIGMA_PX = 0.3  # what one residual is worth against that prior
_ITERATIONS = 12
# Numbers of a homography, and of that with a lens and its centre; the centre is held so firmly that
# it takes up no scatter.
_PLANE, _ALL = 8, 12
_LENS_FREEDOM = 10
# After a step that moves every corner by less, the next one moves none by a thousandth of a pixel:
# of a homography alone, and with a lens.
_SMALL_STEP_PX, _SMALL_LENS_STEP_PX = 0.1, 0.02
_SMALL_GAIN = 1e-4
_LEAST_DAMPING = 1e-7
_DAMPING_STEP = 10.0
_TINY = 1e-12
_RUNAWAY = 1e4
# The centre of a lens is not quite the picture's. Each half diagonal that it lies aside counts
# like a residual of so many pixels: in a picture of 640 x 480, a sixtieth of a pixel for each
# pixel, which is little against what it explains of a wide lens, and much against a sharp noise.
_CENTRE_WEIGHT_PX = 6.7
# 180 degrees in a circle of 0.4 of the picture's diagonal.
_MOST_RADIAL = 6.0


def fit_plane(
    points: Array,
    pixels: Array,
    size: tuple[int, int],
    *,
    has_lens: bool = True,
    start: PlanarFit | None = None,
) -> PlanarFit | None:
    """The fit to face points (n, 2) and pixels (n, 2); None where they fix no plane (n < 4).

    `size`: the picture's width and height; `start`: one of that size to begin with, and to take the
    lens from where `has_lens` is False; without it that gives a homography alone.
    """
    if len(points) < 4:
        return None
    centre = (np.array(size, dtype=float) - 1) / 2
    scale = float(np.hypot(*size)) / 2
    bend = start.bend if start is not None and not has_lens else None
    target = ((pixels if bend is None else pixels - bend.at(points)) - centre) / scale
    normal = _normalising(points)
    source = points @ normal[:2, :2].T + normal[:2, 2]
    if start is None:
        homography, _ = cv2.findHomography(source, target, 0)
        if homography is None or not np.all(np.isfinite(homography)):
            return None
        fit = PlanarFit(homography.astype(float), np.zeros(2), centre, scale)
    else:
        fit = replace(start, homography=start.homography @ np.linalg.inv(normal))
    is_lens_free = has_lens and len(points) > 4
    if is_lens_free or start is not None:
        fit = _refined(fit, source, target, is_lens_free=is_lens_free)
    if fit is None:
        return None
    homography = fit.homography @ normal
    return replace(fit, homography=homography / np.linalg.norm(homography), bend=bend)


def settled_fit(
    points: Array,
    pixels: Array,
    size: tuple[int, int],
    enough_px: float,
    *,
    start: PlanarFit | None = None,
) -> PlanarFit | None:
    """Like `fit_plane`; lens and bend stay those of `start`, or none, where all points come within
    `enough_px` so: the search for a better one is long where a face hardly shows it."""
    fit = fit_plane(points, pixels, size, has_lens=False, start=start)
    if fit is None or float(fit.residuals(points, pixels).max()) <= enough_px:
        return fit
    fit = fit_plane(points, pixels, size, start=fit)
    if fit is None or float(fit.residuals(points, pixels).max()) <= enough_px:
        return fit
    return replace(fit, bend=Bend.of(points, pixels - fit.project(points)))


def scatter_about(fit: PlanarFit, points: Array, pixels: Array) -> tuple[float, int]:
    """How far pixels (n, 2) of face points (n, 2) scatter: the sum of squares, pixel², of what no
    homography and no lens near the fit explains of them, and its freedom; 0 for n < 6.

    The lens counts as free also where the fit left it alone: else what it leaves over would look
    like corners that are off. To first order, by what is orthogonal to the fit's derivatives.
    """
    freedom = 2 * len(points) - _LENS_FREEDOM
    if freedom <= 0:
        return 0.0, 0
    normal = _normalising(points)
    homography = fit.homography @ np.linalg.inv(normal)
    numbers = _numbers(homography, fit)
    homogeneous = np.column_stack([points, np.ones(len(points))]) @ normal.T
    error, jacobian = _linearised(numbers, homogeneous, (pixels - fit.centre) / fit.scale)
    # Two more residuals hold the centre of the lens.
    weight = _CENTRE_WEIGHT_PX / fit.scale
    error = np.append(error, -weight * fit.aside)
    jacobian = np.concatenate([jacobian, weight * np.eye(2, _ALL, _ALL - 2)])
    explained = np.linalg.qr(jacobian)[0].T @ error
    return fit.scale**2 * max(0.0, float(error @ error - explained @ explained)), freedom


def _numbers(homography: Array, fit: PlanarFit) -> Array:
    """What is fitted (12,): the first eight of a homography, its last one held at 1, the lens's
    radial numbers, and its centre."""
    return np.concatenate(
        [(homography / homography[2, 2]).reshape(-1)[:_PLANE], fit.radial, fit.aside]
    )


def _normalising(points: Array) -> Array:
    """The similarity (3, 3) that moves points (n, 2) to mean 0 and a spread of 1."""
    mean = points.mean(axis=0)
    scale = 1 / max(float(np.sqrt(np.mean((points - mean) ** 2))), 1e-12)
    return np.array([[scale, 0, -scale * mean[0]], [0, scale, -scale * mean[1]], [0, 0, 1]])


def _refined(
    fit: PlanarFit, points: Array, target: Array, *, is_lens_free: bool
) -> PlanarFit | None:
    """Levenberg-Marquardt over the homography (its last number held at 1: `points` lie about 0),
    the radial coefficients and the centre of the lens.

    None where it runs away, since the points lie on no plane in front of the camera.
    """
    if not abs(fit.homography[2, 2]) > 1e-9:
        return None
    weights = np.zeros(_ALL)
    if is_lens_free:
        weights[8:10] = (_PRIOR_SIGMA_PX / fit.scale / _RADIAL_PRIOR) ** 2
        weights[10:] = (_CENTRE_WEIGHT_PX / fit.scale) ** 2
    small = (_SMALL_LENS_STEP_PX if is_lens_free else _SMALL_STEP_PX) / fit.scale
    homogeneous = np.column_stack([points, np.ones(len(points))])
    numbers = _numbers(fit.homography, fit)
    count = _ALL if is_lens_free else _PLANE
    now = _State.at(numbers, homogeneous, target, weights)
    damping = _LEAST_DAMPING
    for _ in range(_ITERATIONS):
        step = now.step(count, damping)
        if step is None:
            return None
        moved = now.moved(step)
        if float(np.abs(now.jacobian[:, :count] @ step).max()) < small:
            numbers = moved
            break
        there = _State.at(moved, homogeneous, target, weights)
        if is_lens_free and not there.cost <= now.cost:
            # The homography must follow the lens further than their derivatives say.
            step = there.step(_PLANE, _LEAST_DAMPING)
            if step is not None:
                there = _State.at(there.moved(step), homogeneous, target, weights)
        if not there.cost <= now.cost:
            damping *= _DAMPING_STEP
            continue
        gained = now.cost - there.cost
        now, numbers = there, there.numbers
        damping = max(_LEAST_DAMPING, damping / _DAMPING_STEP)
        if gained < _SMALL_GAIN * now.cost:
            break
    homography = np.append(numbers[:_PLANE], 1.0).reshape(3, 3)
    return replace(fit, homography=homography, radial=numbers[8:10], aside=numbers[10:], bend=None)


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """Where a fit has got to. `numbers`: (12,) as of `_numbers`; `error`: (2n,); `jacobian`:
    (2n, 12); `weights`: (12,) of the squares of the numbers."""

    numbers: Array
    error: Array
    jacobian: Array
    weights: Array
    cost: float

    @classmethod
    def at(cls, numbers: Array, homogeneous: Array, target: Array, weights: Array) -> "_State":
        """The state at some numbers."""
        error, jacobian = _linearised(numbers, homogeneous, target)
        cost = float(error @ error + weights @ (numbers * numbers))
        return cls(numbers, error, jacobian, weights, cost)

    def step(self, count: int, damping: float) -> Array | None:
        """The step of the first `count` numbers; None where the fit has run away."""
        if not np.abs(self.jacobian).max() < _RUNAWAY:
            return None
        rows = self.jacobian[:, :count]
        weights = self.weights[:count]
        normal, right = rows.T @ rows, rows.T @ self.error - weights * self.numbers[:count]
        diagonal = normal.reshape(-1)[:: count + 1]
        diagonal += weights
        diagonal *= 1 + damping
        diagonal += _TINY
        is_solved, step = cv2.solve(normal, right[:, None], flags=cv2.DECOMP_CHOLESKY)
        return np.asarray(step, dtype=float)[:, 0] if is_solved else None

    def moved(self, step: Array) -> Array:
        """The numbers after a step of the first of them."""
        moved = self.numbers.copy()
        moved[: len(step)] += step
        moved[8:10] = moved[8:10].clip(-_MOST_RADIAL, _MOST_RADIAL)
        return moved


def _linearised(numbers: Array, homogeneous: Array, target: Array) -> tuple[Array, Array]:
    """Residuals (2n,), all x before all y, in units of the scale, and their derivative (2n, 12) by
    the numbers; `homogeneous`: (n, 3) points."""
    radial = numbers[8:10]
    rays = homogeneous @ np.append(numbers[:_PLANE], 1.0).reshape(3, 3).T
    share = shares(rays, radial)
    x, y, depth = rays.T
    squared, square = x * x + y * y, share * share
    # How the share changes with the ray and with the lens, by its own equation.
    lens = squared * square
    slope = share * squared * (2 * radial[0] + 4 * radial[1] * lens) - depth
    slope = np.minimum(slope, -HORIZON)
    outward = -2 * square * (radial[0] + 2 * radial[1] * lens) / slope
    n = len(homogeneous)
    jacobian = np.zeros((2, n, _ALL))
    for axis, place in enumerate((x, y)):
        by_ray = np.stack([place * outward * x, place * outward * y, place * share / slope])
        by_ray[axis] += share
        jacobian[axis, :, :8] = (
            (by_ray[:, :, None] * homogeneous).swapaxes(0, 1).reshape(n, 9)[:, :8]
        )
        jacobian[axis, :, 8] = -place * lens / slope
        jacobian[axis, :, 10 + axis] = 1
    jacobian[:, :, 9] = jacobian[:, :, 8] * lens
    error = target - share[:, None] * rays[:, :2] - numbers[10:]
    return error.T.reshape(-1), jacobian.reshape(2 * n, _ALL)
