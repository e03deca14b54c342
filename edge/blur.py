"""How a picture shows the edges of a print: softened or sharpened, lighter or darker than drawn."""

from dataclasses import dataclass

import numpy as np

from trigpoint.geometry.rotation import Array

# Bounds of the variances, pixel²: below 0 the camera sharpens, as most webcams do; the upper one is
# that of 6 pixels of motion.
LEAST_VARIANCE = -1.5
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

    def changed(self, change: Array) -> "Blur":
        """The blur after a change (4,) of the variances and the response, within the bounds."""
        change = np.clip(change, -MOST_CHANGE, MOST_CHANGE)
        values, axes = np.linalg.eigh(_matrix(self.variances + change[:3]))
        matrix = (axes * np.clip(values, LEAST_VARIANCE, MOST_VARIANCE)) @ axes.T
        response = float(np.clip(self.response + change[3], -MOST_RESPONSE, MOST_RESPONSE))
        return Blur(np.array([matrix[0, 0], matrix[1, 1], matrix[0, 1]]), response)

    def softened(self, variance: float) -> "Blur":
        """The blur of a picture that is softened further, the same in all directions; pixel²."""
        return Blur(self.variances + np.array([variance, variance, 0.0]), self.response)

    def kernel(self, step: int) -> np.ndarray:
        """What softens so on a lattice of `step` points a pixel, (2r + 1, 2r + 1) float32.

        A Gaussian along each principal axis, of LEAST_GAUSSIAN at least; what is less is taken away
        by its second derivative (the heat equation), which leaves the halos of a sharpened picture.
        """
        variances, axes = np.linalg.eigh(step**2 * _matrix(self.variances))
        spread = np.maximum(variances, step**2 * LEAST_GAUSSIAN)
        radius = np.ceil(_REACH_SIGMAS * np.sqrt(spread.max()))
        places = np.arange(2 * int(np.clip(radius, _LEAST_RADIUS, MOST_RADIUS)) + 1, dtype=float)
        places -= places[-1] / 2
        along = np.stack(np.meshgrid(places, places), axis=-1) @ axes / np.sqrt(spread)
        squares = along * along
        taken = 1 + 0.5 * (squares - 1) @ ((variances - spread) / spread)
        kernel = np.exp(-0.5 * squares.sum(axis=-1)) * taken
        return (kernel / kernel.sum()).astype(np.float32)


SHARP = Blur(np.array([0.35, 0.35, 0.0]))
"""That of a sharp lens and of the pixel's own width."""


def _matrix(variances: Array) -> Array:
    """The same as a matrix (2, 2)."""
    return variances[[0, 2, 2, 1]].reshape(2, 2)
