"""Fits a flat face to its pixels, to predict corners, and to drop wild ones.

The model is a homography followed by radial distortion about the picture's centre (two
coefficients with a weak prior towards none), so that a lens does not look like noise.
"""

from dataclasses import dataclass

import cv2
import numpy as np

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
# Steps and gains that move no corner by a thousandth of a pixel.
_SMALL_STEP = 2e-6
_SMALL_GAIN = 1e-4
_LEAST_DAMPING = 1e-7
_DAMPING_STEP = 10.0
_TINY = 1e-12 * np.eye(11)
_RUNAWAY = 1e4


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

    def project(self, points: Array) -> Array:
        """Pixels (n, 2) of face points (n, 2)."""
        return self._project(points)[0]

    def straight(self, points: Array) -> Array:
        """Where a lens without distortion would have face points (n, 2); pixels (n, 2)."""
        return self.centre + self.scale * self._project(points)[1]

    def residuals(self, points: Array, pixels: Array) -> Array:
        """Distance of each pixel (n, 2) from where the fit puts its point; (n,), pixels."""
        return np.linalg.norm(self.project(points) - pixels, axis=-1)

    def moved(self, offset_px: Array) -> "PlanarFit":
        """The fit of a face that is `offset_px` (2,) further in a picture without distortion."""
        shift = np.eye(3)
        shift[:2, 2] = offset_px / self.scale
        return PlanarFit(shift @ self.homography, self.radial, self.centre, self.scale)

    def points(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Face points x and y of pixels x and y (any one shape, float32), by way of the lens."""
        flat_x = (x - np.float32(self.centre[0])) * np.float32(1 / self.scale)
        flat_y = (y - np.float32(self.centre[1])) * np.float32(1 / self.scale)
        if self.radial.any():
            squared = flat_x * flat_x + flat_y * flat_y
            factor = self._straightening(float(squared.min()), float(squared.max()), squared)
            flat_x, flat_y = flat_x * factor, flat_y * factor
        inverse = np.linalg.inv(self.homography)
        m = (inverse / np.abs(inverse).max()).astype(np.float32)
        depth = m[2, 0] * flat_x + m[2, 1] * flat_y + m[2, 2]
        return (
            (m[0, 0] * flat_x + m[0, 1] * flat_y + m[0, 2]) / depth,
            (m[1, 0] * flat_x + m[1, 1] * flat_y + m[1, 2]) / depth,
        )

    def _straightening(self, low: float, high: float, squared: np.ndarray) -> np.ndarray:
        """Undistorted over distorted radius for squared distorted radii between low and high.

        The inverse is smooth over one face: a cubic through nine Newton solutions meets it to 1e-5.
        """
        nodes = np.linspace(low, high, 9)
        bent = np.sqrt(nodes)
        straight = bent.copy()
        for _ in range(8):
            square = straight * straight
            gain = 1 + square * (self.radial[0] + square * self.radial[1])
            slope = 1 + square * (3 * self.radial[0] + 5 * square * self.radial[1])
            straight -= (straight * gain - bent) / np.maximum(slope, 0.1)
            straight = np.clip(straight, 0.0, 3 * bent)  # beyond the lens's fold nothing is found
        share = np.divide(straight, bent, out=np.ones(9), where=bent > 1e-9)
        middle, half = 0.5 * (low + high), max(0.5 * (high - low), 1e-9)
        cubic = np.polyfit((nodes - middle) / half, share, 3).astype(np.float32)
        place = (squared - np.float32(middle)) * np.float32(1 / half)
        return ((cubic[0] * place + cubic[1]) * place + cubic[2]) * place + cubic[3]

    def _project(self, points: Array) -> tuple[Array, Array, Array]:
        """Pixels, undistorted coordinates and the homogeneous points (n, 3) before division."""
        homogeneous = np.column_stack([points, np.ones(len(points))])
        mapped = homogeneous @ self.homography.T
        mapped[np.abs(mapped[:, 2]) < 1e-9, 2] = 1e-9  # a point on the horizon: far away, not NaN
        flat = mapped[:, :2] / mapped[:, 2:]
        squared = np.sum(flat * flat, axis=-1, keepdims=True)
        bent = flat * (1 + squared * (self.radial[0] + squared * self.radial[1]))
        return self.centre + self.scale * bent, flat, mapped


def fit_plane(
    points: Array, pixels: Array, size: tuple[int, int], *, has_lens: bool = True
) -> PlanarFit | None:
    """The fit to face points (n, 2) and pixels (n, 2); None where they fix no plane (n < 4).

    `size`: the picture's width and height; `has_lens` False: a homography alone, at a tenth of the
    time.
    """
    if len(points) < 4:
        return None
    centre = (np.array(size, dtype=float) - 1) / 2
    scale = float(np.hypot(*size)) / 2
    target = (pixels - centre) / scale
    normal = _normalising(points)
    source = points @ normal[:2, :2].T + normal[:2, 2]
    homography, _ = cv2.findHomography(source, target, 0)
    if homography is None or not np.all(np.isfinite(homography)):
        return None
    start = homography.astype(float) / np.linalg.norm(homography)
    fit = PlanarFit(start, np.zeros(2), centre, scale)
    if has_lens and len(points) > 4:
        fit = _refined(fit, source, target)
    if fit is None:
        return None
    return PlanarFit(fit.homography @ normal, fit.radial, centre, scale)


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
) -> tuple[np.ndarray, PlanarFit | None]:
    """Which corners (n,) lie where a flat face has them, and the fit to those.

    `least_px` and `least_share` (of the spacing): what is never called wild. Drops the worst beyond
    WILD_SIGMAS of the others' spread, again and again; no corner is sound where fewer than four
    remain or all scatter.
    """
    keep = np.ones(len(points), dtype=bool)
    spacing = _spacing(pixels)
    least = max(least_px, least_share * spacing)
    flat = fit_plane(points, pixels, size, has_lens=False)
    if flat is None or np.median(flat.residuals(points, pixels)) > max(2.0, CHAOS_SHARE * spacing):
        return np.zeros(len(points), dtype=bool), None
    while keep.sum() >= 4:
        fit = fit_plane(points[keep], pixels[keep], size)
        if fit is None:
            break
        distances = fit.residuals(points, pixels)
        usual = float(np.median(distances[keep])) / 1.18  # the median of a Rayleigh distribution
        if usual > max(LEAST_WILD_PX, SCATTER_SHARE * spacing):
            break
        limit = max(least, WILD_SIGMAS * usual)
        worst = np.where(keep, distances, 0.0)
        if worst.max() <= limit:
            return keep, fit
        keep &= distances < max(limit, 0.7 * float(worst.max()))
    return np.zeros(len(points), dtype=bool), None


def _spacing(pixels: Array) -> float:
    """Median distance of a pixel (n, 2) to the nearest other one; 0 for fewer than two."""
    if len(pixels) < 2:
        return 0.0
    squared = np.sum((pixels[:, None] - pixels[None]) ** 2, axis=-1)
    np.fill_diagonal(squared, np.inf)
    return float(np.median(np.sqrt(squared.min(axis=1))))


def _refined(fit: PlanarFit, points: Array, target: Array) -> PlanarFit | None:
    """Levenberg-Marquardt over the homography's nine numbers (its scale held) and the radial ones.

    None where it runs away, since the points lie on no plane in front of the camera.
    """
    weight = _PRIOR_SIGMA_PX / fit.scale / _RADIAL_PRIOR
    now = PlanarFit(fit.homography, fit.radial, np.zeros(2), 1.0)
    error, jacobian = _linearised(now, points, target)
    cost = _cost(error, weight, now)
    damping = _LEAST_DAMPING
    for _ in range(_ITERATIONS):
        prior = np.zeros((3, 11))
        prior[0, 9] = prior[1, 10] = weight
        prior[2, :9] = now.homography.reshape(-1)
        rows = np.vstack([jacobian, prior])
        if not np.max(np.abs(rows)) < _RUNAWAY:
            return None
        right = rows.T @ np.concatenate([error, -weight * now.radial, [0.0]])
        normal = rows.T @ rows
        step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)) + _TINY, right)
        moved = _moved(now, step)
        error_there, jacobian_there = _linearised(moved, points, target)
        cost_there = _cost(error_there, weight, moved)
        if not cost_there <= cost:
            damping *= _DAMPING_STEP
            continue
        gained = cost - cost_there
        now, error, jacobian, cost = moved, error_there, jacobian_there, cost_there
        damping = max(_LEAST_DAMPING, damping / _DAMPING_STEP)
        if gained < _SMALL_GAIN * cost or np.max(np.abs(step)) < _SMALL_STEP:
            break
    return PlanarFit(now.homography, now.radial, fit.centre, fit.scale)


def _moved(fit: PlanarFit, step: Array) -> PlanarFit:
    homography = fit.homography + step[:9].reshape(3, 3)
    homography = homography / np.linalg.norm(homography)
    return PlanarFit(homography, np.clip(fit.radial + step[9:], -0.9, 0.9), fit.centre, fit.scale)


def _cost(error: Array, weight: float, fit: PlanarFit) -> float:
    return float(error @ error + weight**2 * (fit.radial @ fit.radial))


def _linearised(fit: PlanarFit, points: Array, target: Array) -> tuple[Array, Array]:
    """Residuals (2n,) in units of the scale and their derivative (2n, 11)."""
    pixels, flat, mapped = fit._project(points)
    squared = np.sum(flat * flat, axis=-1)
    k1, k2 = fit.radial
    gain = 1 + squared * (k1 + squared * k2)
    slope = k1 + 2 * k2 * squared
    by_flat = gain[:, None, None] * np.eye(2)
    by_flat = by_flat + 2 * slope[:, None, None] * flat[:, :, None] * flat[:, None, :]
    homogeneous = np.column_stack([points, np.ones(len(points))]) / mapped[:, 2:]
    by_homography = np.zeros((len(points), 2, 9))
    by_homography[:, 0, 0:3] = by_homography[:, 1, 3:6] = homogeneous
    by_homography[:, :, 6:9] = -flat[:, :, None] * homogeneous[:, None, :]
    by_radial = flat[:, :, None] * np.stack([squared, squared**2], axis=-1)[:, None, :]
    jacobian = np.concatenate([by_flat @ by_homography, by_radial], axis=-1)
    return (target - pixels).reshape(-1), jacobian.reshape(-1, 11)
