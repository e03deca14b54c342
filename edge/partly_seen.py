"""Whether a checkerboard of which a part is hidden is that board, and no part of a larger one.

Its rows and columns can be counted where some of each outermost line of corners is seen, and where
the squares end on all four sides.
"""

import numpy as np

from trigpoint.geometry.rotation import Array
from trigpoint.target import Face

from .planar_fit import PlanarFit
from .saddles import sampled

# Of a board's corners, how many must be seen; the same of each outermost line of them.
LEAST_SHARE = 0.6
LEAST_LINE_SHARE = 0.5
# How large a step from square to square is one, of the board's contrast.
LEAST_STEP = 0.25
# Of the steps between squares whose corners are all seen, how many must be there.
LEAST_ALTERNATING = 0.95
# Of the steps along a line of squares beyond the board, how many would be there by chance.
MOST_ALTERNATING_BEYOND = 0.34


def is_partly_seen(grey: np.ndarray, face: Face, fit: PlanarFit, ids: np.ndarray) -> bool:
    """Whether the corners `ids` (n,) that are seen of a board, which lies where `fit` has it, leave
    no doubt which ones they are. Its outermost squares are looked at elsewhere."""
    seen = np.zeros(face.corner_count, dtype=bool)
    seen[ids] = True
    seen = seen.reshape(face.rows - 1, face.columns - 1)
    lines = (seen[0], seen[-1], seen[:, 0], seen[:, -1])
    if seen.mean() < LEAST_SHARE or min(line.mean() for line in lines) < LEAST_LINE_SHARE:
        return False
    rising, contrast = _signed(grey, face, fit)
    within = seen[1:, 1:] & seen[1:, :-1] & seen[:-1, 1:] & seen[:-1, :-1]
    if contrast is None or not _alternate(rising[2:-2, 2:-2], within, contrast):
        return False
    beyond = (rising[0], rising[-1], rising[:, 0], rising[:, -1])
    return all(_steps(side, contrast).mean() <= MOST_ALTERNATING_BEYOND for side in beyond)


def _signed(grey: np.ndarray, face: Face, fit: PlanarFit) -> tuple[Array, float | None]:
    """Grey values of all squares and of those that a larger board would have around them, (rows +
    2, columns + 2), where light ones count as negative; and the contrast, None where one of them is
    not in the picture or dark squares are not darker."""
    x, y = np.meshgrid(np.arange(face.columns + 2) - 2, np.arange(face.rows + 2) - 2)
    centres = face.square * (np.stack([x, y], axis=-1).reshape(-1, 2) + 0.5)
    pixels = fit.project(centres)
    if not np.all((pixels >= 0) & (pixels <= np.array(grey.shape[::-1]) - 1)):
        return np.zeros(x.shape), None
    values = sampled(grey, pixels).reshape(x.shape).astype(float)
    is_dark = (x + y) % 2 == 0
    board = np.s_[1:-1, 1:-1]
    contrast = float(values[board][~is_dark[board]].mean() - values[board][is_dark[board]].mean())
    return np.where(is_dark, values, -values), contrast if contrast > 0 else None


def _alternate(rising: Array, within: np.ndarray, contrast: float) -> bool:
    """Whether neighbouring squares of those `within` are dark and light in turn."""
    across, down = _steps(rising.T, contrast).T, _steps(rising, contrast)
    both_across, both_down = within[:, 1:] & within[:, :-1], within[1:] & within[:-1]
    steps = np.concatenate([across[both_across], down[both_down]])
    return bool(len(steps) and steps.mean() >= LEAST_ALTERNATING)


def _steps(rising: Array, contrast: float) -> np.ndarray:
    """Whether the value falls from dark to light between neighbours along the first axis."""
    return -(rising[1:] + rising[:-1]) > LEAST_STEP * contrast
