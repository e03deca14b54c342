"""Where a flat face's points lie in a picture: a plane, a lens, and a bend.

The model is a homography to rays, and a lens by division (Fitzgibbon 2001): the ray of a pixel (x,
y), taken from the lens's centre, is (x, y, 1 + k1 r² + k2 r⁴). That has fisheye lenses to 180° and
beyond, and is inverted without a search. What both leave, because the lens is another or the face
is not flat, a smooth `Bend` takes up.
"""

from functools import lru_cache

import numpy as np
from msgspec import Struct

from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In, Kernel, Out

# Of a fit as the core packs it: the homography (9), face to undistorted pixels taken from the
# lens's centre in units of `scale`, whose first two columns together have length 1, which stays so
# while a face moves without turning; radial coefficients (2), the picture's centre (2), `scale`,
# half its diagonal, how far aside the lens's centre is (2), and the bend's numbers.
FIT = 45
_PROJECT = Kernel(
    "tp_project", In(np.float64, (FIT,)), In(np.float64, ("n", 2)), Out(np.float64, ("n", 2))
)


class PlanarFit(Struct, frozen=True, eq=False):
    """How face coordinates (metres) become pixels; `packed`: (FIT,), as the core has it."""

    packed: Array

    @classmethod
    @lru_cache(16)
    def of_size(cls, size: tuple[int, int]) -> "PlanarFit":
        """Of a picture's width and height; nothing is fitted yet, nor to be written to."""
        packed = np.zeros(FIT)
        packed[[0, 4, 8, 18, 19]] = 1.0
        packed[11:13], packed[13] = (np.array(size, float) - 1) / 2, np.hypot(*size) / 2
        packed.flags.writeable = False
        return cls(packed)

    def moved(self, change: Array) -> "PlanarFit":
        """The fit of a face whose homography has changed by (9,)."""
        packed = self.packed.copy()
        packed[:9] += change
        return PlanarFit(packed)

    def project(self, points: Array) -> Array:
        """Pixels (n, 2) of face points (n, 2)."""
        pixels = np.empty(points.shape)
        _PROJECT(self.packed, np.ascontiguousarray(points, dtype=float), pixels)
        return pixels

    def residuals(self, points: Array, pixels: Array) -> Array:
        """Distance of each pixel (n, 2) from where the fit puts its point; (n,), pixels."""
        return np.linalg.norm(self.project(points) - pixels, axis=-1)
