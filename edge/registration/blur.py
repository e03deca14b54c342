"""How a picture shows the edges of a print: softened or sharpened, lighter or darker than drawn."""

from dataclasses import dataclass
from functools import cache
from math import ceil, hypot, sqrt

import numpy as np

from trigpoint.geometry.rotation import Array

# Bounds of the variances, pixel²: below 0 the camera sharpens, as most webcams do; the upper one is
# that of 6 pixels of motion.
LEAST_VARIANCE = -1.5
# Where sharpening cannot be told from corners that lie elsewhere: a little less than a pixel's own.
LEAST_SOFT_VARIANCE = 0.12
MOST_VARIANCE = 3.0
# As far as a drawing is softened at least; what is less is made up by second derivatives.
LEAST_GAUSSIAN = 0.2
MOST_RESPONSE = 1.0
# How far one change is trusted.
MOST_CHANGE = np.array([1.0, 1.0, 1.0, 0.5])
# Of a kernel, in its standard deviations and in lattice steps.
_REACH_SIGMAS = 2.6
_LEAST_RADIUS, MOST_RADIUS = 2, 6


@dataclass(frozen=True, slots=True, eq=False)
class Blur:
    """`variances`: (3,) xx, yy and covariance xy of the point spread, pixel², below 0 where the
    camera sharpens. `response`: how much faster grey values rise in the dark than in the light, as
    they do where light clips or ink runs; a value v of 0 to 1 is seen as v + response · v (1 - v).
    """

    variances: Array
    response: float = 0.0

    def changed(self, change: Array, *, least: float = LEAST_VARIANCE) -> "Blur":
        """The blur after a change (4,) of the variances and the response, within the bounds;
        `least`: that of the variances."""
        change = np.minimum(np.maximum(change, -MOST_CHANGE), MOST_CHANGE)
        variances = self.variances + change[:3]
        low, high = _principal(variances)
        if low < least or high > MOST_VARIANCE:
            values, axes = np.linalg.eigh(_matrix(variances))
            matrix = (axes * np.clip(values, least, MOST_VARIANCE)) @ axes.T
            variances = np.array([matrix[0, 0], matrix[1, 1], matrix[0, 1]])
        response = min(max(self.response + float(change[3]), -MOST_RESPONSE), MOST_RESPONSE)
        return Blur(variances, response)

    def softened(self, variance: float) -> "Blur":
        """The blur of a picture that is softened further, the same in all directions; pixel²."""
        return Blur(self.variances + np.array([variance, variance, 0.0]), self.response)

    def kernel(self, step: int) -> np.ndarray:
        """What softens so on a lattice of `step` points a pixel, (2r + 1, 2r + 1) float32.

        A Gaussian along each principal axis, of LEAST_GAUSSIAN at least; what is less is taken away
        by its second derivative (the heat equation), which leaves the halos of a sharpened picture.
        """
        low, high = _principal(step**2 * self.variances)
        least = step**2 * LEAST_GAUSSIAN
        radius = ceil(_REACH_SIGMAS * sqrt(max(high, least)))
        x, y = _places(min(max(radius, _LEAST_RADIUS), MOST_RADIUS))
        if low >= least:
            xx, yy, xy = step**2 * self.variances
            kernel = np.exp((x * x * yy + y * y * xx - 2 * xy * x * y) / (-2 * (xx * yy - xy * xy)))
            return (kernel / kernel.sum()).astype(np.float32)
        variances, axes = np.linalg.eigh(step**2 * _matrix(self.variances))
        spread = np.maximum(variances, least)
        squares = (np.stack([x, y], axis=-1) @ axes) ** 2 / spread
        taken = 1 + 0.5 * (squares - 1) @ ((variances - spread) / spread)
        kernel = np.exp(-0.5 * squares.sum(axis=-1)) * taken
        return (kernel / kernel.sum()).astype(np.float32)


SHARP = Blur(np.array([0.35, 0.35, 0.0]))
"""That of a sharp lens and of the pixel's own width."""


def _matrix(variances: Array) -> Array:
    """The same as a matrix (2, 2)."""
    return variances[[0, 2, 2, 1]].reshape(2, 2)


def _principal(variances: Array) -> tuple[float, float]:
    """The lower and the upper of the principal variances."""
    xx, yy, xy = variances.tolist()
    middle, half = (xx + yy) / 2, hypot((xx - yy) / 2, xy)
    return middle - half, middle + half


@cache
def _places(radius: int) -> tuple[np.ndarray, np.ndarray]:
    """x and y of a kernel's places, (2r + 1, 2r + 1)."""
    places = np.arange(-radius, radius + 1, dtype=float)
    x, y = np.meshgrid(places, places)
    return x, y
