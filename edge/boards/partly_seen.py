"""Whether a checkerboard is as large as it looks, and no part of a larger one.

One that is cut off between two lines of corners, by the picture's edge or by what stands before it,
looks as whole as a smaller one. Where a part is hidden, rows and columns can be counted where some
of each outermost line of corners is seen, and where the squares end on all four sides.
"""

import numpy as np

from trigpoint.edge.image.sampling import sampled
from trigpoint.edge.registration.planar_fit import PlanarFit
from trigpoint.geometry.rotation import Array
from trigpoint.target import Face

# Of a board's corners, how many must be seen; the same of each outermost line of them.
LEAST_SHARE = 0.6
LEAST_LINE_SHARE = 0.5
# How large a step from square to square is one, of the board's contrast.
LEAST_STEP = 0.25
# Of the steps between squares whose corners are all seen, how many must be there.
LEAST_ALTERNATING = 0.95
# Of the steps along a line of squares beyond the board, how many would be there by chance.
MOST_ALTERNATING_BEYOND = 0.34
# How far beyond its outermost squares nothing of a board may go on, squares: less than the white
# around most boards, and little where the picture ends there.
END_SQUARES = (0.25, 0.1)


def is_ended(grey: np.ndarray, face: Face, fit: PlanarFit) -> bool:
    """Whether nothing is to be seen of a next line of squares on any side of a board, which lies
    where `fit` has it."""
    around = (_signed(grey, face, fit, beyond=beyond) for beyond in END_SQUARES)
    return all(_goes_nowhere_on(*each) for each in around)


def is_partly_seen(grey: np.ndarray, face: Face, fit: PlanarFit, ids: np.ndarray) -> bool:
    """Whether the corners `ids` (n,) that are seen of a board, which lies where `fit` has it, leave
    no doubt which ones they are. Its outermost squares are looked at elsewhere."""
    seen = np.zeros(face.corner_count, dtype=bool)
    seen[ids] = True
    seen = seen.reshape(face.rows - 1, face.columns - 1)
    lines = (seen[0], seen[-1], seen[:, 0], seen[:, -1])
    if seen.mean() < LEAST_SHARE or min(line.mean() for line in lines) < LEAST_LINE_SHARE:
        return False
    rising, contrast = _signed(grey, face, fit, beyond=0.5)
    if np.any(np.isnan(rising)):
        return False
    within = seen[1:, 1:] & seen[1:, :-1] & seen[:-1, 1:] & seen[:-1, :-1]
    if not _alternate(rising[2:-2, 2:-2], within, contrast):
        return False
    return _goes_nowhere_on(rising, contrast)


def _goes_nowhere_on(rising: Array, contrast: float) -> bool:
    """Whether no side goes on in dark and light as far as it is in the picture, by what `_signed`
    gives."""
    for side in (rising[0], rising[-1], rising[:, 0], rising[:, -1]):
        known = ~np.isnan(side[1:] + side[:-1])
        if np.any(known) and _steps(side, contrast)[known].mean() > MOST_ALTERNATING_BEYOND:
            return False
    return True


def _signed(grey: np.ndarray, face: Face, fit: PlanarFit, *, beyond: float) -> tuple[Array, float]:
    """Grey values of all squares and of those that a larger board would have around them, which are
    looked at so many squares `beyond` the outermost ones, (rows + 2, columns + 2), where light ones
    count as negative, and what is not in the picture is not a number; and the board's contrast, 0
    where dark squares are not darker."""
    x, y = np.meshgrid(np.arange(face.columns + 2), np.arange(face.rows + 2))
    across = np.r_[-1 - beyond, np.arange(face.columns) - 0.5, face.columns - 1 + beyond]
    down = np.r_[-1 - beyond, np.arange(face.rows) - 0.5, face.rows - 1 + beyond]
    pixels = fit.project(face.square * np.column_stack([across[x].ravel(), down[y].ravel()]))
    inside = np.all((pixels >= 0) & (pixels <= np.array(grey.shape[::-1]) - 1), axis=1)
    values = np.where(inside, sampled(grey, pixels), np.nan).reshape(x.shape)
    is_dark = (x + y) % 2 == 0
    dark, light = values[1:-1, 1:-1][is_dark[1:-1, 1:-1]], values[1:-1, 1:-1][~is_dark[1:-1, 1:-1]]
    return np.where(is_dark, values, -values), max(0.0, float(np.nanmean(light) - np.nanmean(dark)))


def _alternate(rising: Array, within: np.ndarray, contrast: float) -> bool:
    """Whether neighbouring squares of those `within` are dark and light in turn."""
    across, down = _steps(rising.T, contrast).T, _steps(rising, contrast)
    both_across, both_down = within[:, 1:] & within[:, :-1], within[1:] & within[:-1]
    steps = np.concatenate([across[both_across], down[both_down]])
    return bool(len(steps) and steps.mean() >= LEAST_ALTERNATING)


def _steps(rising: Array, contrast: float) -> np.ndarray:
    """Whether the value falls from dark to light between neighbours along the first axis."""
    return -(rising[1:] + rising[:-1]) > LEAST_STEP * contrast
