"""Where a flat face's points lie in a picture: a plane, a lens, and a bend.

The model is a homography to rays, and a lens by division (Fitzgibbon 2001): the ray of a pixel (x,
y), taken from the lens's centre, is (x, y, 1 + k1 r² + k2 r⁴). That has fisheye lenses to 180° and
beyond, and is inverted without a search. What both leave, because the lens is another or the face
is not flat, a smooth `Bend` takes up.
"""

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In, Kernel, Out

from .bend import Bend

# Of a fit as it crosses the border to the core.
FIT = 45
_PROJECT = Kernel(
    "tp_project", In(np.float64, (FIT,)), In(np.float64, ("n", 2)), Out(np.float64, ("n", 2))
)


class PlanarFit(Struct, frozen=True):
    """How face coordinates (metres) become pixels.

    `homography`: (3, 3), face to undistorted pixels taken from the lens's centre in units of
    `scale`, half a diagonal; `radial`: (2,); `centre`: (2,) of the picture; `aside`: (2,) the
    lens's from there, in units of `scale`.
    """

    homography: Array
    radial: Array
    centre: Array
    scale: float
    bend: Bend | None = None
    aside: Array = field(default_factory=lambda: np.zeros(2))

    @property
    def size(self) -> tuple[int, int]:
        """The picture's width and height."""
        width, height = (2 * self.centre + 1).round().astype(int).tolist()
        return width, height

    @property
    def lens(self) -> Array:
        """The numbers of the lens and of its place, (4,)."""
        return np.concatenate([self.radial, self.aside])

    @property
    def packed(self) -> Array:
        """As it crosses the border to the core, (FIT,)."""
        numbers = np.zeros(FIT)
        numbers[:9] = self.homography.reshape(-1)
        numbers[9:11], numbers[11:13], numbers[13] = self.radial, self.centre, self.scale
        numbers[14:16], numbers[18:20] = self.aside, 1.0
        if self.bend:
            numbers[16:18], numbers[18:20] = self.bend.middle, self.bend.half
            numbers[20], numbers[21:] = self.bend.degree, self.bend.values.reshape(-1)
        return numbers

    @classmethod
    def unpacked(cls, numbers: Array) -> "PlanarFit":
        """The fit of the core's numbers (FIT,)."""
        bend = None
        if numbers[20]:
            values = numbers[21:].reshape(-1, 2).copy()
            bend = Bend(numbers[16:18].copy(), numbers[18:20].copy(), int(numbers[20]), values)
        return cls(
            numbers[:9].reshape(3, 3).copy(),
            numbers[9:11].copy(),
            numbers[11:13].copy(),
            float(numbers[13]),
            bend,
            numbers[14:16].copy(),
        )

    def project(self, points: Array) -> Array:
        """Pixels (n, 2) of face points (n, 2)."""
        pixels = np.empty(points.shape)
        _PROJECT(self.packed, np.ascontiguousarray(points, dtype=float), pixels)
        return pixels

    def scaled(self, unit: float) -> "PlanarFit":
        """The same for points in units of `unit` metres."""
        bend = self.bend and replace(
            self.bend, middle=self.bend.middle / unit, half=self.bend.half / unit
        )
        return replace(self, homography=self.homography * [unit, unit, 1.0], bend=bend)

    def residuals(self, points: Array, pixels: Array) -> Array:
        """Distance of each pixel (n, 2) from where the fit puts its point; (n,), pixels."""
        return np.linalg.norm(self.project(points) - pixels, axis=-1)

    def points(
        self, x: np.ndarray, y: np.ndarray, then: Array | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Face points x and y of pixels x and y (float32, shapes that broadcast), by way of the
        lens; `then` (3, 3): moved on by that."""
        inverse = np.linalg.inv(self.homography)
        if self.bend is None:
            return self._straight_points(x, y, inverse if then is None else then @ inverse)
        # The bend is small and smooth: where it moves a point to is where it would move that too.
        there_x, there_y = self._straight_points(x, y, inverse)
        about = np.column_stack([there_x.ravel(), there_y.ravel()]).astype(float)
        aside = self.project(about) - replace(self, bend=None).project(about)
        x = x - aside[:, 0].reshape(there_x.shape).astype(np.float32)
        y = y - aside[:, 1].reshape(there_y.shape).astype(np.float32)
        return self._straight_points(x, y, inverse if then is None else then @ inverse)

    def _straight_points(
        self, x: np.ndarray, y: np.ndarray, inverse: Array
    ) -> tuple[np.ndarray, np.ndarray]:
        """The same for a face without a bend, moved on by `inverse` (3, 3)."""
        middle_x, middle_y = (self.centre + self.scale * self.aside).astype(np.float32)
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
