"""Sub-pixel positions of corners."""

import cv2
import numpy as np

from trigpoint.geometry.rotation import Array

LEAST_HALF_WINDOW_PX = 2
MOST_HALF_WINDOW_PX = 8
# The window must not reach the next corner, also along its diagonal.
WINDOW_SHARE = 0.45
_CRITERIA = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 30, 0.005)


def refined_saddles(grey: np.ndarray, pixels: Array, spacing: Array) -> Array:
    """X corners (n, 2) moved to where the gradients say they are.

    `spacing`: (n,) distance to the nearest other corner, pixels; it sets the window of each
    (OpenCV's cornerSubPix doubles its error where the window reaches the next corner). A corner
    that would leave its window stays.
    """
    halves = half_windows(spacing)
    refined = pixels.astype(np.float32)
    for half in np.unique(halves):
        chosen = halves == half
        start = np.ascontiguousarray(refined[chosen]).reshape(-1, 1, 2)
        window = (int(half), int(half))
        moved = cv2.cornerSubPix(grey, start.copy(), window, (-1, -1), _CRITERIA)
        refined[chosen] = moved.reshape(-1, 2)
    return refined.astype(float)


def half_windows(spacing: Array) -> np.ndarray:
    """Half the side of the window of each corner (n,), whole pixels."""
    return np.clip(spacing * WINDOW_SHARE, LEAST_HALF_WINDOW_PX, MOST_HALF_WINDOW_PX).astype(int)


def nearest_spacing(pixels: Array) -> Array:
    """Distance of each pixel (n, 2) to the nearest other one (n,); infinite for a lone one."""
    squared = np.sum((pixels[:, None] - pixels[None]) ** 2, axis=-1)
    np.fill_diagonal(squared, np.inf)
    return np.sqrt(squared.min(axis=1))
