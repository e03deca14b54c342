"""Measures corners by laying the printed pattern over the picture.

Around each corner the pattern is drawn as the camera must see it: through the face's planar fit, so
in its perspective and lens, and blurred as the picture is (`patches`). What is left between drawing
and picture says how far the corner is off (`alignment`). Next squares and markers are in the
drawing, so they pull at nothing, and blur widens both alike.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from trigpoint.geometry.rotation import Array

from .alignment import Alignment, aligned
from .middle import median
from .patches import MOST_HALF_PX, CornerPattern, patches_around
from .planar_fit import PlanarFit, sound_corners

ROUNDS = 6
ROUGH_ROUNDS = 2
# By how many corners a face is first brought near.
ROUGH_CORNERS = 16
# Variances xx and yy and covariance of the picture's blur to start from, pixel²: that of a sharp
# lens and of the pixel's own width.
START_BLUR = np.array([0.35, 0.35, 0.0])
# By how much a picture is softened where corners are off by more than its own blur, pixel².
SOFTENING = np.array([1.6, 1.6, 0.0])
# A step is trusted so far, pixels.
LONGEST_STEP_PX = 1.0
LONGEST_ROUGH_STEP_PX = 2.5
# Where most steps are shorter, what is left of them is of no account.
NEAR_STEP_PX = 0.5
# Steps so short change nothing in how corners look.
STILL_STEP_PX = 0.3
SMALL_STEP_PX = 0.03
SETTLED_STEP_PX = 0.15
SMALL_BLUR_CHANGE = 0.3
_AROUND_PX = MOST_HALF_PX + 6


@dataclass(frozen=True, slots=True)
class Registration:
    """Where corners are. `pixels`: (n, 2); `is_clear`: (n,) whether the picture shows the corner as
    the pattern has it; `sigma`: (n,) of a coordinate by the picture's noise, pixels; `blur`: (3,)
    variances xx, yy and covariance xy of the picture's blur, pixel²; `fit`: the last one used."""

    pixels: Array
    is_clear: np.ndarray
    sigma: Array
    blur: Array
    fit: PlanarFit


def registered(
    grey: np.ndarray,
    pattern: CornerPattern,
    fit: PlanarFit,
    ids: np.ndarray,
    *,
    blur: Array | None = None,
    is_rough: bool = False,
) -> Registration:
    """The corners `ids` (n,) of a face that lies about where `fit` has it: to a pixel or so, or to
    two or three where `is_rough` (then one more round is made, with a wider drawing)."""
    points = pattern.points[ids]
    size = (grey.shape[1], grey.shape[0])
    sharp = START_BLUR if blur is None else blur
    if is_rough:
        fit = _approached(grey, pattern, fit, _spread(ids), sharp)
    pixels = fit.project(points)
    clear, sigma = np.zeros(len(ids), dtype=bool), np.zeros(len(ids))
    usual, moves = np.inf, np.zeros(len(ids))
    for turn in range(ROUNDS):
        if turn > 0 and (usual > STILL_STEP_PX or not clear.all()):
            fit, pixels = _refitted(fit, points, pixels, clear, size)
        found = aligned(patches_around(grey, pattern, fit, ids, pixels), sharp, LONGEST_STEP_PX)
        change = float(np.abs(found.blur - sharp).max())
        clear, sigma, sharp = found.is_clear, found.sigma, found.blur
        pixels = pixels + np.where(clear[:, None], found.step, 0.0)
        usual, moves = _usual_length(found), np.linalg.norm(found.step, axis=1)
        if usual < SMALL_STEP_PX and change < SMALL_BLUR_CHANGE:
            break
    # A corner that still moves has not found its place.
    clear = clear & (moves < SETTLED_STEP_PX)
    return Registration(pixels, clear, sigma, sharp, fit)


def _spread(ids: np.ndarray) -> np.ndarray:
    """ROUGH_CORNERS of the corners, or so, from all over the face; the first and the last too."""
    count = min(len(ids), ROUGH_CORNERS)
    return ids[np.linspace(0, len(ids) - 1, count).round().astype(int)]


def _approached(
    grey: np.ndarray, pattern: CornerPattern, fit: PlanarFit, ids: np.ndarray, blur: Array
) -> PlanarFit:
    """A fit that is off by a pixel at most, found in the softened picture."""
    points, size = pattern.points[ids], (grey.shape[1], grey.shape[0])
    pixels = fit.project(points)
    soft = _softened(grey, pixels)
    for _ in range(ROUGH_ROUNDS):
        patches = patches_around(soft, pattern, fit, ids, pixels)
        found = aligned(patches, blur + SOFTENING, LONGEST_ROUGH_STEP_PX)
        pixels = pixels + np.where(found.is_clear[:, None], found.step, 0.0)
        fit, pixels = _refitted(fit, points, pixels, found.is_clear, size)
        if _usual_length(found) < NEAR_STEP_PX:
            break
    return fit


def _usual_length(found: Alignment) -> float:
    """The length of most clear corners' steps, pixels; infinite where none is clear."""
    if not found.is_clear.any():
        return np.inf
    return median(np.linalg.norm(found.step[found.is_clear], axis=1))


def _softened(grey: np.ndarray, pixels: Array) -> np.ndarray:
    """The picture with the part about `pixels` (n, 2) blurred by SOFTENING, the rest left out."""
    low = np.clip(np.floor(pixels.min(axis=0)).astype(int) - _AROUND_PX, 0, None)
    high = np.ceil(pixels.max(axis=0)).astype(int) + _AROUND_PX
    part = np.s_[low[1] : high[1], low[0] : high[0]]
    soft = np.zeros_like(grey)
    if grey[part].size:
        soft[part] = cv2.GaussianBlur(grey[part], (0, 0), float(np.sqrt(SOFTENING[0])))
    return soft


def _refitted(
    fit: PlanarFit, points: Array, pixels: Array, clear: np.ndarray, size: tuple[int, int]
) -> tuple[PlanarFit, Array]:
    """The plane through the clear corners, and all of them, the others where it has them."""
    usable, better = sound_corners(points[clear], pixels[clear], size, start=fit)
    if better is None:
        return fit, pixels
    kept = clear.copy()
    kept[clear] = usable
    return better, np.where(kept[:, None], pixels, better.project(points))
