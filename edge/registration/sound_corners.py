"""Which of a face's corners are where a flat face has them, and which are wild."""

import numpy as np

from trigpoint.edge.image.median import median
from trigpoint.geometry.rotation import Array

from .planar_fit import PlanarFit
from .plane_fitting import fit_plane, settled_fit

LEAST_WILD_PX = 0.7
# Of a face's grid spacing: real boards are not flat to better than this.
LEAST_WILD_SHARE = 0.04
WILD_SIGMAS = 5.0
# Of the spacing: corners that scatter by so much are not those of one flat face.
SCATTER_SHARE = 0.1
# Corners that are so far off even before a lens is fitted are not worth the fit.
CHAOS_SHARE = 0.4


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
