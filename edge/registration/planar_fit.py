"""Where a flat face's points lie in a picture: a plane, a lens, and a bend.

The model is a homography to rays, and a lens by division (Fitzgibbon 2001): the ray of a pixel (x,
y), taken from the lens's centre, is (x, y, 1 + k1 r² + k2 r⁴). That has fisheye lenses to 180° and
beyond, and is inverted without a search. What both leave, because the lens is another or the face
is not flat, a smooth `Bend` takes up.
"""

import numpy as np
from msgspec import Struct

from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In, Kernel, Out

# Of a fit as the core packs it: homography, radial, centre, scale, aside, and the bend's.
FIT = 45
_BEND = slice(16, 20)
_DEGREE = 20
_PROJECT = Kernel(
    "tp_project", In(np.float64, (FIT,)), In(np.float64, ("n", 2)), Out(np.float64, ("n", 2))
)


class PlanarFit(Struct, frozen=True, eq=False):
    """How face coordinates (metres) become pixels; `packed`: (FIT,), as the core has it."""

    packed: Array

    @classmethod
    def of_size(cls, size: tuple[int, int]) -> "PlanarFit":
        """Of a picture's width and height; nothing is fitted yet."""
        packed = np.zeros(FIT)
        packed[[0, 4, 8, 18, 19]] = 1.0
        packed[11:13], packed[13] = (np.array(size, float) - 1) / 2, np.hypot(*size) / 2
        return cls(packed)

    @property
    def homography(self) -> Array:
        """(3, 3), face to undistorted pixels taken from the lens's centre in units of `scale`, with
        what was fitted in front of the camera. The core makes its first two columns together of
        length 1, which stays so while a face moves without turning."""
        return self.packed[:9].reshape(3, 3)

    @property
    def radial(self) -> Array:
        """The lens's coefficients, (2,)."""
        return self.packed[9:11]

    @property
    def centre(self) -> Array:
        """The lens's centre, (2,) pixels."""
        return self.packed[11:13] + self.scale * self.packed[14:16]

    @property
    def scale(self) -> float:
        """Half the picture's diagonal, pixels."""
        return float(self.packed[13])

    @property
    def is_bent(self) -> bool:
        """Whether there is something that the lens does not explain."""
        return bool(self.packed[_DEGREE])

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

    def scaled(self, unit: float) -> "PlanarFit":
        """The same for points in units of `unit` metres."""
        packed = self.packed.copy()
        packed[:9].reshape(3, 3)[:, :2] *= unit
        packed[_BEND] /= unit
        return PlanarFit(packed)

    def residuals(self, points: Array, pixels: Array) -> Array:
        """Distance of each pixel (n, 2) from where the fit puts its point; (n,), pixels."""
        return np.linalg.norm(self.project(points) - pixels, axis=-1)

    def points(
        self, x: np.ndarray, y: np.ndarray, then: Array | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Face points x and y of pixels x and y (float32, shapes that broadcast), by way of the
        lens; `then` (3, 3): moved on by that."""
        inverse = np.linalg.inv(self.homography)
        if not self.is_bent:
            return self._straight_points(x, y, inverse if then is None else then @ inverse)
        # The bend is small and smooth: where it moves a point to is where it would move that too.
        there_x, there_y = self._straight_points(x, y, inverse)
        about = np.column_stack([there_x.ravel(), there_y.ravel()]).astype(float)
        straight = self.packed.copy()
        straight[_DEGREE] = 0.0
        aside = self.project(about) - PlanarFit(straight).project(about)
        x = x - aside[:, 0].reshape(there_x.shape).astype(np.float32)
        y = y - aside[:, 1].reshape(there_y.shape).astype(np.float32)
        return self._straight_points(x, y, inverse if then is None else then @ inverse)

    def _straight_points(
        self, x: np.ndarray, y: np.ndarray, inverse: Array
    ) -> tuple[np.ndarray, np.ndarray]:
        """The same for a face without a bend, moved on by `inverse` (3, 3)."""
        middle_x, middle_y = self.centre.astype(np.float32)
        flat_x = (x - middle_x) * np.float32(1 / self.scale)
        flat_y = (y - middle_y) * np.float32(1 / self.scale)
        m = (inverse / np.abs(inverse).max()).astype(np.float32)
        first, second = (np.float32(value) for value in self.radial)
        squared = flat_x * flat_x + flat_y * flat_y
        forward = 1 + squared * (first + squared * second)
        above_x, above_y, depth = (
            row[0] * flat_x + row[1] * flat_y + row[2] * forward for row in m
        )
        depth[depth == 0] = 1e-9  # on the horizon
        above_x /= depth
        above_y /= depth
        return above_x, above_y
