"""How a picture shows the edges of a print: softened or sharpened, lighter or darker than drawn."""

import numpy as np
from msgspec import Struct

from trigpoint.geometry.rotation import Array


class Blur(Struct, frozen=True, eq=False):
    """`variances`: (3,) xx, yy and covariance xy of the point spread, pixel², below 0 where the
    camera sharpens. `response`: how much faster grey values rise in the dark than in the light, as
    they do where light clips or ink runs; a value v of 0 to 1 is seen as v + response · v (1 - v).
    """

    variances: Array
    response: float = 0.0


SHARP = Blur(np.array([0.35, 0.35, 0.0]))
"""That of a sharp lens and of the pixel's own width."""
