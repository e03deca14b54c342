"""Fits a flat face to its pixels, to predict corners, and to drop wild ones.

The model is a homography followed by radial distortion about the picture's centre (two
coefficients with a weak prior towards none), so that a lens does not look like noise.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from trigpoint.edge.image.median import median
from trigpoint.geometry.rotation import Array

LEAST_WILD_PX = 0.7
# Of a face's grid spacing: real boards are not flat to better than this.
LEAST_WILD_SHARE = 0.04
WILD_SIGMAS = 5.0
# Of the spacing: corners that scatter by so much are not those of one flat face.
SCATTER_SHARE = 0.1
# Corners that are so far off even before a lens is fitted are not worth the fit.
CHAOS_SHARE = 0.4
_RADIAL_PRIOR = 0.25  # of each coefficient, at the corner of the picture
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
_MOST_RADIAL = 0.9
# Where the lens is inverted, and the cubic (highest power first) through values there.
_NODES = np.linspace(-1.0, 1.0, 9)
_CUBIC = np.linalg.pinv(np.vander(_NODES, 4))
_NEWTON_STEPS = 5


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

    @property
    def size(self) -> tuple[int, int]:
        """The picture's width and height."""
        width, height = (2 * self.centre + 1).round().astype(int).tolist()
        return width, height

    def project(self, points: Array) -> Array:
        """Pixels (n, 2) of face points (n, 2)."""
        return self._project(points)[0]

    def straight(self, points: Array) -> Array:
        """Where a lens without distortion would have face points (n, 2); pixels (n, 2)."""
        return self.centre + self.scale * self._project(points)[1]

    def residuals(self, points: Array, pixels: Array) -> Array:
        """Distance of each pixel (n, 2) from where the fit puts its point; (n,), pixels."""
        return np.linalg.norm(self.project(points) - pixels, axis=-1)

    def points(
        self, x: np.ndarray, y: np.ndarray, then: Array | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Face points x and y of pixels x and y (float32, shapes that broadcast), by way of the
        lens; `then` (3, 3): moved on by that."""
        flat_x = (x - np.float32(self.centre[0])) * np.float32(1 / self.scale)
        flat_y = (y - np.float32(self.centre[1])) * np.float32(1 / self.scale)
        inverse = np.linalg.inv(self.homography)
        inverse = inverse if then is None else then @ inverse
        m = (inverse / np.abs(inverse).max()).astype(np.float32)
        factor = self._straightening(flat_x, flat_y) if self.radial.any() else np.float32(1)
        above_x, above_y, depth = (row[0] * flat_x + row[1] * flat_y for row in m)
        for part, row in zip((above_x, above_y, depth), m, strict=True):
            part *= factor
            part += row[2]
        depth[depth == 0] = 1e-9  # on the horizon
        above_x /= depth
        above_y /= depth
        return above_x, above_y

    def _straightening(self, flat_x: np.ndarray, flat_y: np.ndarray) -> np.ndarray:
        """Undistorted over distorted radius at distorted coordinates (float32, they broadcast).

        The inverse is smooth over one face: a cubic through nine Newton solutions meets it to 1e-5.
        """
        squared_x, squared_y = flat_x * flat_x, flat_y * flat_y
        low = float(squared_x.min()) + float(squared_y.min())
        high = float(squared_x.max()) + float(squared_y.max())
        middle, half = 0.5 * (low + high), max(0.5 * (high - low), 1e-9)
        bent = np.sqrt(middle + half * _NODES)
        straight = bent.copy()
        for _ in range(_NEWTON_STEPS):
            square = straight * straight
            gain = 1 + square * (self.radial[0] + square * self.radial[1])
            slope = 1 + square * (3 * self.radial[0] + 5 * square * self.radial[1])
            straight -= (straight * gain - bent) / np.maximum(slope, 0.1)
            straight = np.clip(straight, 0.0, 3 * bent)  # beyond the lens's fold nothing is found
        share = np.divide(straight, bent, out=np.ones(len(_NODES)), where=bent > 1e-9)
        cubic = (_CUBIC @ share).astype(np.float32)
        by_half = np.float32(1 / half)
        place = (squared_x - np.float32(middle)) * by_half + squared_y * by_half
        factor = cubic[0] * place
        for number in cubic[1:3]:
            factor += number
            factor *= place
        factor += cubic[3]
        return factor

    def _project(self, points: Array) -> tuple[Array, Array, Array]:
        """Pixels, undistorted coordinates and the homogeneous points (n, 3) before division."""
        mapped = points @ self.homography[:, :2].T + self.homography[:, 2]
        mapped[np.abs(mapped[:, 2]) < 1e-9, 2] = 1e-9  # a point on the horizon: far away, not NaN
        flat = mapped[:, :2] / mapped[:, 2:]
        squared = np.sum(flat * flat, axis=-1, keepdims=True)
        bent = flat * (1 + squared * (self.radial[0] + squared * self.radial[1]))
        return self.centre + self.scale * bent, flat, mapped


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
    target = (pixels - centre) / scale
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
    return PlanarFit(homography / np.linalg.norm(homography), fit.radial, centre, scale)


def settled_fit(
    points: Array,
    pixels: Array,
    size: tuple[int, int],
    enough_px: float,
    *,
    start: PlanarFit | None = None,
) -> PlanarFit | None:
    """Like `fit_plane`; the lens stays that of `start`, or none, where all points come within
    `enough_px` so: the search for a better one is long where a face hardly shows it."""
    fit = fit_plane(points, pixels, size, has_lens=False, start=start)
    if fit is None or float(fit.residuals(points, pixels).max()) <= enough_px:
        return fit
    return fit_plane(points, pixels, size, start=fit)


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
    explained = np.linalg.qr(jacobian)[0].T @ error
    return fit.scale**2 * max(0.0, float(error @ error - explained @ explained)), freedom


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
    least_share: float = LEAST_WILD_SHARE,
    enough_px: float | None = None,
    start: PlanarFit | None = None,
) -> tuple[np.ndarray, PlanarFit | None]:
    """Which corners (n,) lie where a flat face has them, and the fit to those.

    `least_px` and `least_share` (of the spacing): what is never called wild; `enough_px`: of
    `settled_fit`, the same where it is left out; `start`: a fit that is nearly right. Drops the
    worst beyond WILD_SIGMAS of the others' spread, again and again; no corner is sound where fewer
    than four remain or all scatter.
    """
    keep = np.ones(len(points), dtype=bool)
    if len(points) < 4:
        return ~keep, None
    spacing = _spacing(pixels)
    least = max(least_px, least_share * spacing)
    fit = start or fit_plane(points, pixels, size, has_lens=False)
    if fit is None or median(fit.residuals(points, pixels)) > max(2.0, CHAOS_SHARE * spacing):
        return np.zeros(len(points), dtype=bool), None
    while keep.sum() >= 4:
        fit = settled_fit(
            points[keep], pixels[keep], size, least if enough_px is None else enough_px, start=fit
        )
        if fit is None:
            break
        distances = fit.residuals(points, pixels)
        usual = median(distances[keep]) / 1.18  # the median of a Rayleigh distribution
        if usual > max(LEAST_WILD_PX, SCATTER_SHARE * spacing):
            break
        limit = max(least, WILD_SIGMAS * usual)
        worst = float(np.max(distances[keep]))
        if worst <= limit:
            return keep, fit
        keep &= distances < max(limit, 0.7 * worst)
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
    k1, k2 = numbers[8], numbers[9]
    mapped = homogeneous @ np.append(numbers[:8], 1.0).reshape(3, 3).T
    depth = mapped[:, 2]
    depth[np.abs(depth) < 1e-9] = 1e-9  # a point on the horizon: far away, not NaN
    mapped /= depth[:, None]
    x, y = mapped[:, 0], mapped[:, 1]
    source = homogeneous / depth[:, None]
    squared = x * x + y * y
    gain = 1 + squared * (k1 + squared * k2)
    slope = 2 * (k1 + 2 * k2 * squared)
    outward = gain + slope * squared
    n = len(homogeneous)
    jacobian = np.empty((2, n, 10))
    jacobian[0, :, 0:3] = (gain + slope * x * x)[:, None] * source
    jacobian[1, :, 3:6] = (gain + slope * y * y)[:, None] * source
    jacobian[0, :, 3:6] = jacobian[1, :, 0:3] = (slope * x * y)[:, None] * source
    jacobian[0, :, 6:8] = -(outward * x)[:, None] * source[:, :2]
    jacobian[1, :, 6:8] = -(outward * y)[:, None] * source[:, :2]
    jacobian[0, :, 8], jacobian[1, :, 8] = squared * x, squared * y
    jacobian[:, :, 9] = jacobian[:, :, 8] * squared
    error = np.concatenate([target[:, 0] - gain * x, target[:, 1] - gain * y])
    return error, jacobian.reshape(2 * n, 10)
