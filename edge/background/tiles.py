"""Tiles of a background: where they are found again in another picture, and how surely."""

import cv2
import numpy as np
from msgspec import Struct
from numpy.lib.stride_tricks import sliding_window_view

from trigpoint.geometry.rotation import Array

HALF = 5
"""A tile reaches so many pixels from its middle, to all sides."""
REACH = 3
"""A tile is looked for so many pixels from where it is expected, along each axis: a degree."""
CELL = 20
"""The picture is divided into cells of this side; each gives its best tile, if it has one."""
_PIXELS = (2 * HALF + 1) ** 2
LEAST_CORRELATION = 0.6
"""A tile that correlates less at its best place is not found."""
SIGMA_PX = 0.12
"""What shadows, haze and the sway of a mount add to a tile's place, standard deviation."""
_MOST_SIGMA_PX = 0.25
"""A tile whose place is known less well could not tell a turn of 0.3 degrees; it is not found."""
_LEAST_LENGTH, _LEAST_VARIANCE = 1e-3, 0.1
_LEAST_CONTRAST = 2.0
"""Grey levels of the weaker gradient of a corner; below that a tile is noise."""


class Tiles(Struct, frozen=True, eq=False):
    """`middles`: (n, 2) whole pixels, x and y; `patches`: (n, 11, 11) float32."""

    middles: np.ndarray
    patches: np.ndarray

    def __len__(self) -> int:
        return len(self.middles)

    def at(self, rows: np.ndarray) -> "Tiles":
        """Only these of them; `rows`: indices or a mask."""
        return Tiles(self.middles[rows], self.patches[rows])


class Matches(Struct, frozen=True, eq=False):
    """Where tiles were found. `shifts`: (n, 2) pixels from a tile's own middle; `precisions`:
    (n, 2, 2), the inverse of their covariances; `is_inside`: (n,) whether it could be looked for;
    `is_found`: and was found."""

    middles: np.ndarray
    shifts: Array
    precisions: Array
    is_inside: np.ndarray
    is_found: np.ndarray

    def distances(self, expected: Array) -> Array:
        """Squared Mahalanobis distances (n,) from these shifts (n, 2)."""
        return self.apart(self.shifts, expected)

    def apart(self, some: Array, others: Array) -> Array:
        """Squared Mahalanobis distances (n,) between shifts (n, 2), as surely as they are seen."""
        off = some - others
        return np.einsum("ni,nij,nj->n", off, self.precisions, off)


def tiles_of(small: np.ndarray, is_usable: np.ndarray) -> Tiles:
    """The best corner of every cell of a small picture (h, w); `is_usable`: (h, w) bool."""
    weaker = cv2.cornerMinEigenVal(small, 5, ksize=3)
    border = HALF + REACH + 1
    strength = np.where(is_usable, weaker, 0.0)[border:-border, border:-border]
    rows, columns = strength.shape[0] // CELL, strength.shape[1] // CELL
    if not rows or not columns:
        return Tiles(np.zeros((0, 2), int), np.zeros((0, 2 * HALF + 1, 2 * HALF + 1), np.float32))
    cells = strength[: rows * CELL, : columns * CELL].reshape(rows, CELL, columns, CELL)
    flat = cells.swapaxes(1, 2).reshape(rows * columns, CELL * CELL)
    best = flat.argmax(axis=1)
    is_strong = flat[np.arange(len(flat)), best] > _least_strength()
    row, column = np.divmod(np.arange(len(flat)), columns)
    y, x = np.divmod(best, CELL)
    middles = np.stack([column * CELL + x, row * CELL + y], axis=1)[is_strong] + border
    return Tiles(middles, around(small, middles, HALF))


def _least_strength() -> float:
    # cornerMinEigenVal gives the mean square of Sobel's gradient, scaled by 1 / (4 · 5).
    return (_LEAST_CONTRAST / 20) ** 2


def match(
    tiles: Tiles, small: np.ndarray, *, reach: int = REACH, start: np.ndarray | None = None
) -> Matches:
    """Look for tiles in a small picture (h, w), up to `reach` pixels along each axis about their
    own places, or about `start` (2,) whole pixels from there. A best place at the edge of that is
    none.

    The correlation is normalised, so that neither gain nor offset of the light counts. Its
    curvature gives the covariance of a shift, as of a template in white noise.
    """
    shift = np.zeros(2, int) if start is None else start
    places = tiles.middles + shift
    margin = HALF + reach
    is_inside = np.all((places >= margin) & (places < np.array(small.shape[::-1]) - margin), axis=1)
    places = np.where(is_inside[:, None], places, margin)
    surfaces = _correlations(tiles.patches, small, places, reach)
    return _found(tiles, surfaces, is_inside, shift)


def _correlations(
    patches: np.ndarray, small: np.ndarray, places: np.ndarray, reach: int
) -> np.ndarray:
    """Normalised correlations (n, 2 reach + 1, 2 reach + 1) of patches (n, 11, 11) about places
    (n, 2)."""
    plain = patches - patches.mean(axis=(1, 2), keepdims=True)
    lengths = np.linalg.norm(plain, axis=(1, 2), keepdims=True)
    plain /= np.maximum(lengths, _LEAST_LENGTH)
    count, side = len(patches), 2 * reach + 1
    views = sliding_window_view(around(small, places, HALF + reach), plain.shape[1:], (1, 2))
    windows = views.reshape(count, side * side, _PIXELS)
    plain = plain.reshape(count, _PIXELS)
    products, sums = np.moveaxis(windows @ np.stack([plain, np.ones_like(plain)], axis=2), 2, 0)
    squares = np.einsum("nkp,nkp->nk", windows, windows)
    spread = np.sqrt(np.maximum(squares - sums**2 / _PIXELS, _LEAST_VARIANCE))
    return (products / spread).reshape(count, side, side)


def around(values: np.ndarray, places: np.ndarray, half: int) -> np.ndarray:
    """Values (n, 2 half + 1, 2 half + 1) of a picture about places (n, 2), x and y."""
    reach = np.arange(-half, half + 1)
    x, y = places.T
    return values[y[:, None, None] + reach[:, None], x[:, None, None] + reach]


def _found(tiles: Tiles, surfaces: np.ndarray, is_inside: np.ndarray, shift: np.ndarray) -> Matches:
    """The peaks of correlations (n, side, side), to fractions of pixels."""
    count, side = surfaces.shape[:2]
    best = surfaces.reshape(count, side * side).argmax(axis=1)
    y, x = np.divmod(best, side)
    is_peak = (x > 0) & (x < side - 1) & (y > 0) & (y < side - 1)
    x, y, n = np.clip(x, 1, side - 2), np.clip(y, 1, side - 2), np.arange(count)
    near = surfaces[n[:, None, None], y[:, None, None] + _STEP[:, None], x[:, None, None] + _STEP]
    gradient, curvature = _quadratic(near.astype(float))
    peak = np.clip(near[:, 1, 1].astype(float), 1e-3, 1 - 1e-6)
    inverse = _inverse(curvature)
    fraction = np.clip((inverse @ gradient[:, :, None])[..., 0], -1.0, 1.0)
    noise = (1 - peak**2) / (peak**2 * _PIXELS)
    covariances = noise[:, None, None] * inverse + SIGMA_PX**2 * _IDENTITY
    shifts = np.stack([x, y], axis=1) - side // 2 + shift + fraction
    is_sharp = covariances[:, 0, 0] + covariances[:, 1, 1] < 2 * _MOST_SIGMA_PX**2
    is_found = is_inside & is_peak & is_sharp & (peak > LEAST_CORRELATION)
    return Matches(tiles.middles, shifts, _inverse(covariances), is_inside, is_found)


def _inverse(matrices: Array) -> Array:
    """The inverses of symmetric matrices (n, 2, 2); a fifth of the time of NumPy's."""
    xx, xy, yy = matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 1]
    rows = np.stack([yy, -xy, -xy, xx], axis=1) / (xx * yy - xy * xy)[:, None]
    return rows.reshape(-1, 2, 2)


_STEP = np.array([-1, 0, 1])
_LEAST_CURVATURE = 1e-3
_IDENTITY = np.eye(2)


def _quadratic(near: Array) -> tuple[Array, Array]:
    """The gradient (n, 2) and the negative Hessian (n, 2, 2) in the middle of values (n, 3, 3)."""
    gradient = 0.5 * np.stack(
        [near[:, 1, 2] - near[:, 1, 0], near[:, 2, 1] - near[:, 0, 1]], axis=1
    )
    middle = 2 * near[:, 1, 1]
    xx = np.maximum(middle - near[:, 1, 2] - near[:, 1, 0], _LEAST_CURVATURE)
    yy = np.maximum(middle - near[:, 2, 1] - near[:, 0, 1], _LEAST_CURVATURE)
    xy = 0.25 * (near[:, 0, 2] + near[:, 2, 0] - near[:, 0, 0] - near[:, 2, 2])
    xy = np.clip(xy, -0.95 * np.sqrt(xx * yy), 0.95 * np.sqrt(xx * yy))
    return gradient, np.stack([np.stack([xx, xy], 1), np.stack([xy, yy], 1)], 1)
