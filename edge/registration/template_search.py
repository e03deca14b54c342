"""Finds where a face went since it was last seen: a small drawing of it, held against the picture
about the place where it is expected."""

from collections.abc import Sequence

import cv2
import numpy as np

from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In, Kernel, Out

from .corner_pattern import CornerPattern, Print
from .planar_fit import FIT, PlanarFit
from .plane_fitting import fit_plane

# The drawing's longer side at most, and of a square at least, in its own pixels.
MOST_SIDE = 40
LEAST_SQUARE = 3.0
# How well it must match (normalised correlation) for the face to be there.
LEAST_MATCH = 0.35
# A face larger than so many pictures is not looked for; it was not projected in earnest.
_MOST_SIZES = 1.5
_DRAWN = Kernel(
    "tp_face_drawn",
    Print,
    In(np.float64, (FIT,)),
    In(np.float64, (2,)),
    float,
    float,
    In(np.float64, (4, 2)),
    Out(np.float32, ("h", "w")),
)


def found_by_template(
    grey: np.ndarray, pattern: CornerPattern, fit: PlanarFit, reach_px: float
) -> PlanarFit | None:
    """Where a face lies that should lie where `fit` has it, or up to `reach_px` beside that: to a
    pixel or so; None where it is not to be seen."""
    outline = fit.project(pattern.outline)
    low, size = np.floor(outline.min(axis=0)), np.ptp(outline, axis=0)
    if not np.all(size < _MOST_SIZES * np.array(grey.shape[::-1])) or size.min() < LEAST_SQUARE:
        return None
    square_px = float(np.sqrt(np.prod(size) / (pattern.face.columns * pattern.face.rows)))
    step = max(1, min(round(float(size.max()) / MOST_SIDE), int(square_px / LEAST_SQUARE)))
    cells = np.ceil(size / step).astype(int) + 1
    reach = int(np.ceil(reach_px / step))
    drawn = np.empty(cells[::-1], np.float32)
    _DRAWN(pattern.core, fit.packed, low, step, square_px / step, pattern.outline, drawn)
    # The part begins so many cells before the drawing's place; what is outside the picture is grey.
    part = _part(grey, (low - step * reach).astype(int), step * (cells + 2 * reach))
    small = cv2.resize(part, tuple((cells + 2 * reach).tolist()), interpolation=cv2.INTER_AREA)
    match = cv2.matchTemplate(small.astype(np.float32), drawn, cv2.TM_CCOEFF_NORMED)
    _, best, _, place = cv2.minMaxLoc(match)
    if not best >= LEAST_MATCH:
        return None
    offset = step * (np.array(place) + _between(match, place) - reach)
    points = pattern.points
    size_px = (grey.shape[1], grey.shape[0])
    return fit_plane(points, fit.project(points) + offset, size_px, has_lens=False, start=fit)


def _part(grey: np.ndarray, low: np.ndarray, size: np.ndarray) -> np.ndarray:
    """The part of a picture that begins at `low` (2,) and is `size` (2,) wide and high."""
    limit = np.array(grey.shape[::-1])
    first, last = np.clip(low, 0, limit), np.clip(low + size, 0, limit)
    part = np.full((size[1], size[0]), 128, np.uint8)
    to, end = first - low, last - low
    part[to[1] : end[1], to[0] : end[0]] = grey[first[1] : last[1], first[0] : last[0]]
    return part


def _between(match: np.ndarray, place: Sequence[int]) -> Array:
    """How far the best match lies beside the best whole place (x, y), by a parabola each way."""
    x, y = place
    offset = np.zeros(2)
    for axis, line, at in ((0, match[y], x), (1, match[:, x], y)):
        if 0 < at < len(line) - 1:
            before, here, after = (float(value) for value in line[at - 1 : at + 2])
            bend = before - 2 * here + after
            offset[axis] = 0.5 * (before - after) / bend if bend < -1e-6 else 0.0
    return np.clip(offset, -0.5, 0.5)
