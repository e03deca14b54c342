"""The picture about each corner of a face, and what is printed there, drawn as the camera sees it.

The drawing is on a lattice of half pixels, so that its derivatives are those of the picture.
"""

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from trigpoint.edge.image.median import median
from trigpoint.geometry.rotation import Array
from trigpoint.target import Face, Pattern

from .planar_fit import PlanarFit
from .printed_pattern import PrintedPattern, printed_pattern_of

LEAST_HALF_PX = 3
MOST_HALF_PX = 6
STEP = 2  # lattice points a pixel
MARGIN_PX = 3  # of the drawing around the picture's part, for blur to come from
# Where the map from pixels to the print is looked up: so far from a patch's middle, of its half.
_STENCIL = 0.75
_THREE = np.array([-1.0, 0.0, 1.0], np.float32)
_SLACK = 0.05  # of the reach, left out beside an unknown sector


@dataclass(frozen=True, slots=True, eq=False)
class CornerPattern:
    """What a face has around its corners. `points`: (n, 2) corners in the face frame; `reach`: how
    far from a corner along both axes is looked at, metres; `outward`: (n, 2) signs of the axes'
    directions of a sector that may be printed or not (Kalibr has squares there), 0 without one."""

    face: Face
    points: Array
    reach: float
    outward: Array

    @property
    def is_balanced(self) -> bool:
        """Whether dark and light lie alike around every corner. Where they do not, ink that runs
        looks like corners that lie elsewhere."""
        return not self.outward.any()

    @classmethod
    @cache
    def of(cls, face: Face) -> "CornerPattern":
        """The pattern of any face."""
        points = face.corners[:, :2]
        outward = np.zeros_like(points)
        reach = 0.5 * face.square
        if face.pattern is Pattern.APRILGRID:
            if not face.corner_squares:
                outward = np.tile(
                    [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]], (len(points) // 4, 1)
                )
            reach = min(0.5 * (face.marker or 0.0), face.square - (face.marker or 0.0))
        return cls(face, points, reach, outward)


@dataclass(frozen=True, slots=True, eq=False)
class Patches:
    """`seen`, `weight`: (n, k²) grey values, and 1 where they count; `drawn`: (n, l, l) the print's
    grey values on the lattice, MARGIN_PX wider, sharp."""

    seen: np.ndarray
    weight: np.ndarray
    drawn: np.ndarray


def patches_around(
    grey: np.ndarray,
    pattern: CornerPattern,
    fit: PlanarFit,
    ids: np.ndarray,
    pixels: Array,
    nearest: Array,
) -> Patches:
    """Patches about whole pixels `nearest` (n, 2), the pattern moved from where `fit` has it so
    that its corners lie at `pixels` (n, 2)."""
    n, reach = len(ids), pattern.reach
    points = pattern.points[ids]
    along = np.array([[0.0, 0.0], [reach, 0.0], [0.0, reach]])
    beside = (along[:, None] + points).reshape(-1, 2)
    expected, across, down = fit.project(beside).reshape(3, n, 2)
    across, down = across - expected, down - expected
    longest = float(np.max(np.abs(across) + np.abs(down), initial=0.0))
    half = int(np.clip(np.ceil(longest), LEAST_HALF_PX, MOST_HALF_PX))
    reach_px = median(np.hypot(*across.T) + np.hypot(*down.T)) / 2
    printed = printed_pattern_of(pattern.face, reach_px / reach * pattern.face.square)
    texel_x, texel_y = _texels(fit, printed, nearest - (pixels - expected), half + MARGIN_PX)
    seen, inside = _gathered(grey, nearest.astype(int), half)
    weight = inside & _near(pattern, ids, printed, texel_x, texel_y)
    return Patches(
        seen.reshape(n, -1),
        weight.reshape(n, -1).astype(np.float32),
        _drawn(printed, texel_x, texel_y),
    )


def _texels(
    fit: PlanarFit, printed: PrintedPattern, middles: Array, half: int
) -> tuple[np.ndarray, np.ndarray]:
    """x and y of the print's texels on the half pixels about pixels `middles` (n, 2); (n, l, l).

    So near a corner they are quadratic in the pixels, to a thousandth: through nine places.
    """
    to_numbers, basis = _quadratic(half)
    places = middles.astype(np.float32)[..., None] + np.float32(_STENCIL * half) * _THREE
    known = fit.points(places[:, 0, None, :], places[:, 1, :, None], printed.texel_from_face)
    side = 2 * STEP * half + 1
    x, y = ((v.reshape(-1, 9) @ to_numbers @ basis).reshape(-1, side, side) for v in known)
    return x, y


@cache
def _quadratic(half: int) -> tuple[np.ndarray, np.ndarray]:
    """From values at nine places to the quadratic through them (9, 6), and from that to values on
    the lattice (6, l²); float32."""

    def terms(places: np.ndarray) -> np.ndarray:
        y, x = (part.reshape(-1) for part in np.meshgrid(places, places, indexing="ij"))
        return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y])

    to_numbers = np.linalg.pinv(terms(_STENCIL * _THREE)).astype(np.float32)
    return to_numbers, terms(np.linspace(-1.0, 1.0, 2 * STEP * half + 1)).astype(np.float32)


def _near(
    pattern: CornerPattern,
    ids: np.ndarray,
    printed: PrintedPattern,
    texel_x: np.ndarray,
    texel_y: np.ndarray,
) -> np.ndarray:
    """Whether whole pixels of the lattice (n, l, l) show what is known about the corner;
    (n, k, k)."""
    whole = slice(STEP * MARGIN_PX, -STEP * MARGIN_PX, STEP)
    corner = (pattern.points[ids] * printed.scale + printed.offset).astype(np.float32)
    reach = np.float32(pattern.reach * printed.scale)
    off_x = texel_x[:, whole, whole] - corner[:, 0, None, None]
    off_y = texel_y[:, whole, whole] - corner[:, 1, None, None]
    near = np.maximum(np.abs(off_x), np.abs(off_y)) < reach
    if pattern.outward.any():
        out = pattern.outward[ids].astype(np.float32)[:, :, None, None]
        slack = -_SLACK * reach
        near &= ~((off_x * out[:, 0] > slack) & (off_y * out[:, 1] > slack))
    return near


def _gathered(grey: np.ndarray, nearest: np.ndarray, half: int) -> tuple[np.ndarray, np.ndarray]:
    """Grey values (n, k, k) about whole pixels (n, 2), and whether they lie in the picture."""
    places = np.arange(-half, half + 1)
    rows, columns = nearest[:, 1, None] + places, nearest[:, 0, None] + places
    height, width = grey.shape
    in_rows, in_columns = (rows >= 0) & (rows < height), (columns >= 0) & (columns < width)
    rows, columns = np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)
    seen = grey.reshape(-1).take(rows[:, :, None] * width + columns[:, None, :])
    return seen.astype(np.float32), in_rows[:, :, None] & in_columns[:, None, :]


def _drawn(printed: PrintedPattern, texel_x: np.ndarray, texel_y: np.ndarray) -> np.ndarray:
    """The print at texels (n, l, l), as many float32."""
    n, side, _ = texel_x.shape
    drawn = cv2.remap(
        printed.texels,
        texel_x.reshape(-1, side),
        texel_y.reshape(-1, side),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return drawn.astype(np.float32).reshape(n, side, side)
