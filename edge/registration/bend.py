"""What a homography and a lens of two numbers leave of a face's corners: smooth, over the face.

A printed face curls, and a lens is not quite the one of the fit; both move neighbouring corners
alike. Legendre polynomials of the face's coordinates take that up; their constant and linear parts
are the homography's.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from trigpoint.geometry.rotation import Array

# So many corners to every number of the bend, or it would take up wild corners too.
CORNERS_A_TERM = 4
MOST_DEGREE = 4
# Beyond the corners, of half their extent, a bend goes on so far: the squares about a small board.
_BEYOND = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class Bend:
    """A smooth displacement over a face. `middle`, `half`: (2,) of the part of the face that it was
    fitted to; `values`: (m, 2) of its polynomials, pixels."""

    middle: Array
    half: Array
    values: Array

    def at(self, points: Array) -> Array:
        """The displacement (n, 2) at face points (n, 2), pixels; beyond its part as at its edge."""
        places = np.clip((points - self.middle) / self.half, -_BEYOND, _BEYOND)
        return _terms(places, _DEGREE_OF[len(self.values)]) @ self.values

    @classmethod
    def of(cls, points: Array, left: Array) -> "Bend | None":
        """The bend in what is left (n, 2) of face points (n, 2); None where they are too few."""
        enough = [d for d, count in _COUNTS.items() if count * CORNERS_A_TERM <= len(points)]
        degree = max(enough, default=0)
        low, high = points.min(axis=0), points.max(axis=0)
        if degree == 0 or np.any(high <= low):
            return None
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        values, *_ = np.linalg.lstsq(_terms((points - middle) / half, degree), left)
        return cls(middle, half, values)


@cache
def _powers(degree: int) -> tuple[tuple[int, int], ...]:
    """The degrees along x and y of the terms of a bend."""
    return tuple((i, n - i) for n in range(2, degree + 1) for i in range(n + 1))


_COUNTS = {degree: len(_powers(degree)) for degree in range(2, MOST_DEGREE + 1)}
_DEGREE_OF = {count: degree for degree, count in _COUNTS.items()}


def _terms(places: Array, degree: int) -> Array:
    """Products of Legendre polynomials (n, m) at places (n, 2) of -1 to 1."""
    lines = [np.ones_like(places), places]
    for n in range(1, degree):
        lines.append(((2 * n + 1) * places * lines[n] - n * lines[n - 1]) / (n + 1))
    across, down = np.stack(lines).transpose(2, 0, 1)
    i, j = np.array(_powers(degree)).T
    return (across[i] * down[j]).T
