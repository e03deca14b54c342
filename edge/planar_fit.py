"""Fits a flat face to its pixels, to predict corners, to drop wild ones and to tell their sigma.

The model is a homography followed by radial distortion about the picture's centre (two
coefficients with a weak prior towards none), so that a lens does not look like noise.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from trigpoint.geometry.rotation import Array

LEAST_SIGMA_PX = 0.05
# Where a face has few corners its residuals say little: they are mixed with this many degrees of
# freedom of a usual corner.
USUAL_SIGMA_PX = 0.15
USUAL_WEIGHT = 6.0
LEAST_WILD_PX = 0.7
# Of a face's grid spacing: real boards are not flat to better than this.
LEAST_WILD_SHARE = 0.04
WILD_SIGMAS = 5.0
# Of the spacing: corners that scatter by so much are not those of one flat face.
SCATTER_SHARE = 0.1
_RADIAL_PRIOR = 0.25  # of each coefficient, at the corner of the picture
_PRIOR_SIGMA_PX = 0.3  # what one residual is worth against that prior
_ITERATIONS = 12
_SMALL_STEP = 1e-7
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

    def residuals(self, points: Array, pixels: Array) -> Array:
        """Distance of each pixel (n, 2) from where the fit puts its point; (n,), pixels."""
        return np.linalg.norm(self.project(points) - pixels, axis=-1)

    def _project(self, points: Array) -> tuple[Array, Array, Array]:
        """Pixels, undistorted coordinates and the homogeneous points (n, 3) before division."""
        homogeneous = np.column_stack([points, np.ones(len(points))])
        mapped = homogeneous @ self.homography.T
        mapped[np.abs(mapped[:, 2]) < 1e-9, 2] = 1e-9  # a point on the horizon: far away, not NaN
        flat = mapped[:, :2] / mapped[:, 2:]
        squared = np.sum(flat * flat, axis=-1, keepdims=True)
        bent = flat * (1 + squared * (self.radial[0] + squared * self.radial[1]))
        return self.centre + self.scale * bent, flat, mapped


def fit_plane(points: Array, pixels: Array, size: tuple[int, int]) -> PlanarFit | None:
    """The fit to face points (n, 2) and pixels (n, 2); None where they fix no plane (n < 4).

    `size`: the picture's width and height.
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
    if len(points) > 4:
        fit = _refined(fit, source, target)
    if fit is None:
        return None
    return PlanarFit(fit.homography @ normal, fit.radial, centre, scale)


def _normalising(points: Array) -> Array:
    """The similarity (3, 3) that moves points (n, 2) to mean 0 and a spread of 1."""
    mean = points.mean(axis=0)
    scale = 1 / max(float(np.sqrt(np.mean((points - mean) ** 2))), 1e-12)
    return np.array([[scale, 0, -scale * mean[0]], [0, scale, -scale * mean[1]], [0, 0, 1]])


def sound_corners(points: Array, pixels: Array, size: tuple[int, int]) -> tuple[np.ndarray, float]:
    """Which corners (n,) lie where a flat face has them, and the sigma of those, pixels.

    Drops the worst beyond WILD_SIGMAS of the others' spread, again and again; no corner is sound
    where fewer than four remain or all scatter.
    """
    keep = np.ones(len(points), dtype=bool)
    spacing = _spacing(pixels)
    least = max(LEAST_WILD_PX, LEAST_WILD_SHARE * spacing)
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
            return keep, _sigma(distances[keep])
        keep &= distances < max(limit, 0.7 * float(worst.max()))
    return np.zeros(len(points), dtype=bool), USUAL_SIGMA_PX


def _spacing(pixels: Array) -> float:
    """Median distance of a pixel (n, 2) to the nearest other one; 0 for fewer than two."""
    if len(pixels) < 2:
        return 0.0
    squared = np.sum((pixels[:, None] - pixels[None]) ** 2, axis=-1)
    np.fill_diagonal(squared, np.inf)
    return float(np.median(np.sqrt(squared.min(axis=1))))


def _sigma(distances: Array) -> float:
    """Standard deviation of one coordinate from a fit's residuals, with a usual one mixed in."""
    freedom = max(0, 2 * len(distances) - 8)
    power = float(np.sum(distances**2)) + USUAL_WEIGHT * USUAL_SIGMA_PX**2
    return max(LEAST_SIGMA_PX, float(np.sqrt(power / (freedom + USUAL_WEIGHT))))


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
        now, error, jacobian, cost = moved, error_there, jacobian_there, cost_there
        damping = max(_LEAST_DAMPING, damping / _DAMPING_STEP)
        if np.max(np.abs(step)) < _SMALL_STEP:
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
