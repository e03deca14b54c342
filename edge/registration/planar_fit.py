"""Fits a flat face to its pixels, to predict corners, and to drop wild ones.

The model is a homography to rays, and a lens by division (Fitzgibbon 2001) about the picture's
centre: the ray of a pixel (x, y) is (x, y, 1 + k1 r² + k2 r⁴). That has fisheye lenses to 180° and
beyond, is inverted without a search, and with a weak prior towards none does not look like noise.
What both leave, because the lens is another or the face is not flat, a smooth `Bend` takes up.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from trigpoint.edge.image.median import median
from trigpoint.geometry.rotation import Array

from .bend import Bend

LEAST_WILD_PX = 0.7
# Of a face's grid spacing: real boards are not flat to better than this.
LEAST_WILD_SHARE = 0.04
WILD_SIGMAS = 5.0
# Of the spacing: corners that scatter by so much are not those of one flat face.
SCATTER_SHARE = 0.1
# Corners that are so far off even before a lens is fitted are not worth the fit.
CHAOS_SHARE = 0.4
_RADIAL_PRIOR = 0.5  # of each coefficient, at the corner of the picture
_PRIOR_SIGMA_PX = 0.3  # what one residual is worth against that prior
_ITERATIONS = 12
# Numbers of a homography and a lens.
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
_NEWTON_STEPS = 4
# What no ray in front of the camera comes near to, of its length; and of the quadratic's slope,
# how much at least is left with the second coefficient.
_HORIZON = 1e-9
_LEAST_SLOPE = 0.1


@dataclass(frozen=True, slots=True)
class PlanarFit:
    """How face coordinates (metres) become pixels.

    `homography`: (3, 3), face to undistorted pixels taken from `centre` in units of `scale`;
    `radial`: (2,).
    """

    homography: Array
    radial: Array
    centre: Array
    scale: float
    bend: Bend | None = None

    @property
    def size(self) -> tuple[int, int]:
        """The picture's width and height."""
        width, height = (2 * self.centre + 1).round().astype(int).tolist()
        return width, height

    def project(self, points: Array) -> Array:
        """Pixels (n, 2) of face points (n, 2)."""
        pixels = self._straight(points)
        return pixels if self.bend is None else pixels + self.bend.at(points)

    def residuals(self, points: Array, pixels: Array) -> Array:
        """Distance of each pixel (n, 2) from where the fit puts its point; (n,), pixels."""
        return np.linalg.norm(self.project(points) - pixels, axis=-1)

    def points(
        self, x: np.ndarray, y: np.ndarray, then: Array | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Face points x and y of pixels x and y (float32, shapes that broadcast), by way of the
        lens; `then` (3, 3): moved on by that."""
        inverse = np.linalg.inv(self.homography)
        if self.bend is None:
            return self._straight_points(x, y, inverse if then is None else then @ inverse)
        # The bend is small and smooth: where it moves a point to is where it would move that too.
        there_x, there_y = self._straight_points(x, y, inverse)
        aside = self.bend.at(np.column_stack([there_x.ravel(), there_y.ravel()]))
        x = x - aside[:, 0].reshape(there_x.shape).astype(np.float32)
        y = y - aside[:, 1].reshape(there_y.shape).astype(np.float32)
        return self._straight_points(x, y, inverse if then is None else then @ inverse)

    def _straight_points(
        self, x: np.ndarray, y: np.ndarray, inverse: Array
    ) -> tuple[np.ndarray, np.ndarray]:
        """The same for a face without a bend, moved on by `inverse` (3, 3)."""
        flat_x = (x - np.float32(self.centre[0])) * np.float32(1 / self.scale)
        flat_y = (y - np.float32(self.centre[1])) * np.float32(1 / self.scale)
        m = (inverse / np.abs(inverse).max()).astype(np.float32)
        first, second = (np.float32(value) for value in self.radial)
        squared = flat_x * flat_x + flat_y * flat_y
        forward = 1 + squared * (first + squared * second)
        above_x, above_y, depth = (
            row[0] * flat_x + row[1] * flat_y + row[2] * forward for row in m
        )
        depth[depth == 0] = 1e-9  # on the horizon
        above_x /= depth
        above_y /= depth
        return above_x, above_y

    def _straight(self, points: Array) -> Array:
        """Pixels (n, 2) of face points (n, 2), as if the face were flat."""
        rays = points @ self.homography[:, :2].T + self.homography[:, 2]
        return self.centre + self.scale * rays[:, :2] * _shares(rays, self.radial)[:, None]


def _shares(rays: Array, radial: Array) -> Array:
    """(n,) q of rays (n, 3) to (X, Y, Z), so that the picture has them at q · (X, Y): the root of
    1 + k1 R² q² + k2 R⁴ q⁴ = Z q that is nearest the middle of the picture."""
    squared = rays[:, 0] ** 2 + rays[:, 1] ** 2
    depth, first, second = rays[:, 2], radial[0] * squared, radial[1] * squared * squared
    root = np.sqrt(np.maximum(depth * depth - 4 * first, 0.0))
    # With the first coefficient alone it is a quadratic equation.
    shares = 2 / np.maximum(depth + root, _HORIZON)
    if radial[1]:
        steepest = -np.maximum(_LEAST_SLOPE * root, _HORIZON)
        for _ in range(_NEWTON_STEPS):
            square = shares * shares
            lens = second * square
            error = 1 + square * (first + lens) - depth * shares
            slope = np.minimum(shares * (2 * first + 4 * lens) - depth, steepest)
            better = shares - error / slope
            shares = np.minimum(np.maximum(better, 0.5 * shares), 2 * shares)
    return shares


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
        fit = PlanarFit(start.homography @ np.linalg.inv(normal), start.radial, centre, scale)
    is_lens_free = has_lens and len(points) > 4
    if is_lens_free or start is not None:
        fit = _refined(fit, source, target, is_lens_free=is_lens_free)
    if fit is None:
        return None
    homography = fit.homography @ normal
    return PlanarFit(homography / np.linalg.norm(homography), fit.radial, centre, scale, bend)


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
    numbers = np.concatenate([(homography / homography[2, 2]).reshape(-1)[:8], fit.radial])
    homogeneous = np.column_stack([points, np.ones(len(points))]) @ normal.T
    error, jacobian = _linearised(numbers, homogeneous, (pixels - fit.centre) / fit.scale)
    error, jacobian = _with_centre(error, jacobian, fit.scale)
    explained = np.linalg.qr(jacobian)[0].T @ error
    return fit.scale**2 * max(0.0, float(error @ error - explained @ explained)), freedom


def _with_centre(error: Array, jacobian: Array, scale: float) -> tuple[Array, Array]:
    """Residuals (2n + 2,) and derivative (2n + 2, 12) with the lens's centre free too, near the
    picture's: two more numbers, and two more residuals that hold them."""
    n = len(error) // 2
    every = np.zeros((2 * n + 2, 12))
    every[:-2, :10] = jacobian
    every[:n, 10] = every[n:-2, 11] = 1
    every[-2, 10] = every[-1, 11] = _CENTRE_WEIGHT_PX / scale
    return np.append(error, [0.0, 0.0]), every


def _normalising(points: Array) -> Array:
    """The similarity (3, 3) that moves points (n, 2) to mean 0 and a spread of 1."""
    mean = points.mean(axis=0)
    scale = 1 / max(float(np.sqrt(np.mean((points - mean) ** 2))), 1e-12)
    return np.array([[scale, 0, -scale * mean[0]], [0, scale, -scale * mean[1]], [0, 0, 1]])


def sound_corners(
    points: Array,
    pixels: Array,
    size: tuple[int, int],
    *,
    least_px: float = LEAST_WILD_PX,
    least_share: float | Array = LEAST_WILD_SHARE,
    enough_px: float | None = None,
    start: PlanarFit | None = None,
) -> tuple[np.ndarray, PlanarFit | None]:
    """Which corners (n,) lie where a flat face has them, and the fit to those.

    `least_px` and `least_share` (of the spacing; one, or (n,)): what is never called wild;
    `enough_px`: of
    `settled_fit`, the same where it is left out; `start`: a fit that is nearly right. Drops the
    worst beyond WILD_SIGMAS of the others' spread, again and again; no corner is sound where fewer
    than four remain or all scatter.
    """
    keep = np.ones(len(points), dtype=bool)
    if len(points) < 4:
        return ~keep, None
    spacing = _spacing(pixels)
    least = np.broadcast_to(np.maximum(least_px, least_share * spacing), len(points))
    fit = start or fit_plane(points, pixels, size, has_lens=False)
    if fit is None or median(fit.residuals(points, pixels)) > max(2.0, CHAOS_SHARE * spacing):
        return np.zeros(len(points), dtype=bool), None
    while keep.sum() >= 4:
        fit = settled_fit(
            points[keep],
            pixels[keep],
            size,
            float(least.min()) if enough_px is None else enough_px,
            start=fit,
        )
        if fit is None:
            break
        distances = fit.residuals(points, pixels)
        usual = median(distances[keep]) / 1.18  # the median of a Rayleigh distribution
        if usual > max(LEAST_WILD_PX, SCATTER_SHARE * spacing):
            break
        beyond = distances / np.maximum(least, WILD_SIGMAS * usual)
        worst = float(np.max(beyond[keep]))
        if worst <= 1:
            return keep, fit
        keep &= beyond < max(1.0, 0.7 * worst)
    return np.zeros(len(points), dtype=bool), None


def _spacing(pixels: Array) -> float:
    """Median distance of a pixel (n, 2) to the nearest other one; 0 for fewer than two."""
    if len(pixels) < 2:
        return 0.0
    squared = np.sum((pixels[:, None] - pixels[None]) ** 2, axis=-1)
    np.fill_diagonal(squared, np.inf)
    return float(np.sqrt(median(squared.min(axis=1))))


def _refined(
    fit: PlanarFit, points: Array, target: Array, *, is_lens_free: bool
) -> PlanarFit | None:
    """Levenberg-Marquardt over the homography (its last number held at 1: `points` lie about 0) and
    the radial coefficients.

    None where it runs away, since the points lie on no plane in front of the camera.
    """
    if not abs(fit.homography[2, 2]) > 1e-9:
        return None
    weight = (_PRIOR_SIGMA_PX / fit.scale / _RADIAL_PRIOR) ** 2 if is_lens_free else 0.0
    small = (_SMALL_LENS_STEP_PX if is_lens_free else _SMALL_STEP_PX) / fit.scale
    homogeneous = np.column_stack([points, np.ones(len(points))])
    numbers = np.concatenate([(fit.homography / fit.homography[2, 2]).reshape(-1)[:8], fit.radial])
    count = 10 if is_lens_free else 8
    now = _State.at(numbers, homogeneous, target, weight)
    damping = _LEAST_DAMPING
    for _ in range(_ITERATIONS):
        step = now.step(count, damping)
        if step is None:
            return None
        moved = now.moved(step)
        if float(np.abs(now.jacobian[:, :count] @ step).max()) < small:
            numbers = moved
            break
        there = _State.at(moved, homogeneous, target, weight)
        if is_lens_free and not there.cost <= now.cost:
            # The homography must follow the lens further than their derivatives say.
            step = there.step(8, _LEAST_DAMPING)
            if step is not None:
                there = _State.at(there.moved(step), homogeneous, target, weight)
        if not there.cost <= now.cost:
            damping *= _DAMPING_STEP
            continue
        gained = now.cost - there.cost
        now, numbers = there, there.numbers
        damping = max(_LEAST_DAMPING, damping / _DAMPING_STEP)
        if gained < _SMALL_GAIN * now.cost:
            break
    homography = np.append(numbers[:8], 1.0).reshape(3, 3)
    return PlanarFit(homography, numbers[8:], fit.centre, fit.scale)


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """Where a fit has got to. `numbers`: (10,) the homography's first eight and the radial ones;
    `error`: (2n,); `jacobian`: (2n, 10); `weight`: of the squares of the radial numbers."""

    numbers: Array
    error: Array
    jacobian: Array
    weight: float
    cost: float

    @classmethod
    def at(cls, numbers: Array, homogeneous: Array, target: Array, weight: float) -> "_State":
        """The state at some numbers."""
        error, jacobian = _linearised(numbers, homogeneous, target)
        cost = float(error @ error + weight * (numbers[8:] @ numbers[8:]))
        return cls(numbers, error, jacobian, weight, cost)

    def step(self, count: int, damping: float) -> Array | None:
        """The step of the first `count` numbers; None where the fit has run away."""
        if not np.abs(self.jacobian).max() < _RUNAWAY:
            return None
        rows = self.jacobian[:, :count]
        normal, right = rows.T @ rows, rows.T @ self.error
        if count > 8:
            normal[8, 8] += self.weight
            normal[9, 9] += self.weight
            right[8:] -= self.weight * self.numbers[8:]
        diagonal = normal.reshape(-1)[:: count + 1]
        diagonal *= 1 + damping
        diagonal += _TINY
        is_solved, step = cv2.solve(normal, right[:, None], flags=cv2.DECOMP_CHOLESKY)
        return np.asarray(step, dtype=float)[:, 0] if is_solved else None

    def moved(self, step: Array) -> Array:
        """The numbers after a step of the first of them."""
        moved = self.numbers.copy()
        moved[: len(step)] += step
        moved[8:] = moved[8:].clip(-_MOST_RADIAL, _MOST_RADIAL)
        return moved


def _linearised(numbers: Array, homogeneous: Array, target: Array) -> tuple[Array, Array]:
    """Residuals (2n,), all x before all y, in units of the scale, and their derivative (2n, 10) by
    the homography's first eight numbers and the radial ones; `homogeneous`: (n, 3) points."""
    radial = numbers[8:]
    rays = homogeneous @ np.append(numbers[:8], 1.0).reshape(3, 3).T
    share = _shares(rays, radial)
    x, y, depth = rays.T
    squared, square = x * x + y * y, share * share
    # How the share changes with the ray and with the lens, by its own equation.
    lens = squared * square
    slope = share * squared * (2 * radial[0] + 4 * radial[1] * lens) - depth
    slope = np.minimum(slope, -_HORIZON)
    outward = -2 * square * (radial[0] + 2 * radial[1] * lens) / slope
    n = len(homogeneous)
    jacobian = np.empty((2, n, 10))
    for axis, place in enumerate((x, y)):
        by_ray = np.stack([place * outward * x, place * outward * y, place * share / slope])
        by_ray[axis] += share
        jacobian[axis, :, :8] = (
            (by_ray[:, :, None] * homogeneous).swapaxes(0, 1).reshape(n, 9)[:, :8]
        )
        jacobian[axis, :, 8] = -place * lens / slope
    jacobian[:, :, 9] = jacobian[:, :, 8] * lens
    error = target - share[:, None] * rays[:, :2]
    return error.T.reshape(-1), jacobian.reshape(2 * n, 10)
