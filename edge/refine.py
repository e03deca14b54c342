"""Sub-pixel positions of corners."""

import cv2
import numpy as np

from trigpoint.geometry.rotation import Array

from .saddles import sampled

LEAST_HALF_WINDOW_PX = 2
MOST_HALF_WINDOW_PX = 8
# The window must not reach the next corner, also along its diagonal.
CHECKERBOARD_SHARE = 0.45
_ROUNDS = 2
_ALONG = np.linspace(0.15, 0.85, 11)
_ACROSS = np.linspace(-1.0, 1.0, 17)
_CRITERIA = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 30, 0.005)


def refined_saddles(
    grey: np.ndarray, pixels: Array, spacing: Array, *, share: float = CHECKERBOARD_SHARE
) -> Array:
    """X corners (n, 2) moved to where the gradients say they are.

    `spacing`: (n,) distance to the nearest other corner, pixels; half the window is `share` of it
    (OpenCV's cornerSubPix doubles its error where the window reaches the next corner). A corner
    that would leave its window stays.
    """
    halves = np.clip(spacing * share, LEAST_HALF_WINDOW_PX, MOST_HALF_WINDOW_PX).astype(int)
    refined = pixels.astype(np.float32)
    for half in np.unique(halves):
        chosen = halves == half
        start = np.ascontiguousarray(refined[chosen]).reshape(-1, 1, 2)
        window = (int(half), int(half))
        moved = cv2.cornerSubPix(grey, start.copy(), window, (-1, -1), _CRITERIA)
        refined[chosen] = moved.reshape(-1, 2)
    return refined.astype(float)


def nearest_spacing(pixels: Array) -> Array:
    """Distance of each pixel (n, 2) to the nearest other one (n,); infinite for a lone one."""
    squared = np.sum((pixels[:, None] - pixels[None]) ** 2, axis=-1)
    np.fill_diagonal(squared, np.inf)
    return np.sqrt(squared.min(axis=1))


def refined_quads(grey: np.ndarray, quads: Array, reach: Array) -> Array:
    """Dark quadrilaterals (n, 4, 2) whose sides are moved to their edges, met at the corners.

    Sides are located between their ends, where blur moves nothing: cornerSubPix pulls a convex
    corner inwards as soon as the picture is blurred. `reach`: (n,) how far to look across a side,
    pixels.
    """
    for _ in range(_ROUNDS):
        quads = _meeting(*_side_lines(grey, quads, reach))
    return quads


def _side_lines(grey: np.ndarray, quads: Array, reach: Array) -> tuple[Array, Array]:
    """A point (n, 4, 2) and the direction (n, 4, 2) of the edge along each side."""
    along = np.roll(quads, -1, axis=1) - quads
    direction = along / np.linalg.norm(along, axis=-1, keepdims=True)
    outward = np.stack([direction[..., 1], -direction[..., 0]], axis=-1)
    at = quads[:, :, None] + _ALONG[:, None] * along[:, :, None]
    offsets = reach[:, None] * _ACROSS
    across = offsets[:, None, None, :, None] * outward[:, :, None, None]
    profile = sampled(grey, at[..., None, :] + across)
    rise = np.maximum(np.diff(profile, axis=-1), 0.0)
    rise = np.maximum(rise - 0.2 * rise.max(axis=-1, keepdims=True), 0.0)
    middle = (offsets[:, 1:] + offsets[:, :-1])[:, None, None] / 2
    weight = rise.sum(axis=-1)
    shift = np.sum(rise * middle, axis=-1) / np.maximum(weight, 1e-9)
    slope, offset = _fitted(_ALONG - 0.5, shift, weight)
    length = np.linalg.norm(along, axis=-1)
    point = quads + 0.5 * along + offset[..., None] * outward
    return point, direction + (slope / length)[..., None] * outward


def _fitted(x: Array, y: Array, weight: Array) -> tuple[Array, Array]:
    """Slope and offset (…) of the weighted lines through x (m,), y (…, m)."""
    total = np.maximum(weight.sum(axis=-1), 1e-9)
    mean_x, mean_y = (weight * x).sum(axis=-1) / total, (weight * y).sum(axis=-1) / total
    centred = x - mean_x[..., None]
    spread = np.maximum((weight * centred**2).sum(axis=-1), 1e-9)
    slope = (weight * centred * (y - mean_y[..., None])).sum(axis=-1) / spread
    return slope, mean_y - slope * mean_x


def _meeting(point: Array, direction: Array) -> Array:
    """Corners (n, 4, 2): where each side's line meets that of the side before it."""
    before, along = np.roll(point, 1, axis=1), np.roll(direction, 1, axis=1)
    offset = point - before
    cross = along[..., 0] * direction[..., 1] - along[..., 1] * direction[..., 0]
    cross = np.where(np.abs(cross) > 1e-6, cross, 1e-6)
    part = (offset[..., 0] * direction[..., 1] - offset[..., 1] * direction[..., 0]) / cross
    return before + part[..., None] * along
