"""Where a flat face's points lie in a picture: a plane, a lens, and a bend.

The model is a homography to rays, and a lens by division (Fitzgibbon 2001): the ray of a pixel (x,
y), taken from the lens's centre, is (x, y, 1 + k1 r² + k2 r⁴). That has fisheye lenses to 180° and
beyond, and is inverted without a search. What both leave, because the lens is another or the face
is not flat, a smooth `Bend` takes up.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from trigpoint.geometry.rotation import Array

from .bend import Bend

_NEWTON_STEPS = 4
# What no ray in front of the camera comes near to, of its length; and of the quadratic's slope,
# how much at least is left with the second coefficient.
HORIZON = 1e-9
_LEAST_SLOPE = 0.1


@dataclass(frozen=True, slots=True)
class PlanarFit:
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

    def project(self, points: Array) -> Array:
        """Pixels (n, 2) of face points (n, 2)."""
        pixels = self._straight(points)
        return pixels if self.bend is None else pixels + self.bend.at(points)

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
        aside = self.bend.at(np.column_stack([there_x.ravel(), there_y.ravel()]))
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

    def _straight(self, points: Array) -> Array:
        """Pixels (n, 2) of face points (n, 2), as if the face were flat."""
        rays = points @ self.homography[:, :2].T + self.homography[:, 2]
        from_centre = rays[:, :2] * shares(rays, self.radial)[:, None] + self.aside
        return self.centre + self.scale * from_centre


def shares(rays: Array, radial: Array) -> Array:
    """(n,) q of rays (n, 3) to (X, Y, Z), so that the picture has them at q · (X, Y): the root of
    1 + k1 R² q² + k2 R⁴ q⁴ = Z q that is nearest the lens's centre."""
    squared = rays[:, 0] ** 2 + rays[:, 1] ** 2
    depth, first, second = rays[:, 2], radial[0] * squared, radial[1] * squared * squared
    root = np.sqrt(np.maximum(depth * depth - 4 * first, 0.0))
    # With the first coefficient alone it is a quadratic equation.
    shares = 2 / np.maximum(depth + root, HORIZON)
    if radial[1]:
        steepest = -np.maximum(_LEAST_SLOPE * root, HORIZON)
        for _ in range(_NEWTON_STEPS):
            square = shares * shares
            lens = second * square
            error = 1 + square * (first + lens) - depth * shares
            slope = np.minimum(shares * (2 * first + 4 * lens) - depth, steepest)
            better = shares - error / slope
            shares = np.minimum(np.maximum(better, 0.5 * shares), 2 * shares)
    return shares
