"""Viewing directions for regular grids of (sub)pixels, exact and fast."""

from functools import cache

import numpy as np
from numpy.polynomial import chebyshev

from trigpoint.geometry import CameraModel
from trigpoint.geometry.rotation import Array

SUBPIXELS = 2  # along each side of a pixel
_NODES = 32


@cache
def _coefficients(camera: CameraModel) -> Array:
    """Chebyshev coefficients (nodes, nodes, 2) of the directions over the whole picture.

    A lens is smooth, so 32 × 32 Newton solutions give every pixel to some 1e-9.
    """
    nodes = np.cos(np.pi * (np.arange(_NODES) + 0.5) / _NODES)
    u = (nodes + 1) / 2 * camera.width - 0.5
    v = (nodes + 1) / 2 * camera.height - 0.5
    values = camera.directions(np.stack(np.meshgrid(u, v), axis=-1))
    to_coefficients = np.linalg.inv(chebyshev.chebvander(nodes, _NODES - 1))
    planes = [to_coefficients @ values[..., axis] @ to_coefficients.T for axis in (0, 1)]
    return np.stack(planes, axis=-1)


def directions_on_grid(camera: CameraModel, u: Array, v: Array) -> Array:
    """Normalised coordinates (len(v), len(u), 2) of the pixels (u, v) of a grid."""
    across = chebyshev.chebvander((u + 0.5) / camera.width * 2 - 1, _NODES - 1)
    down = chebyshev.chebvander((v + 0.5) / camera.height * 2 - 1, _NODES - 1)
    coefficients = _coefficients(camera)
    planes = [down @ coefficients[..., axis] @ across.T for axis in (0, 1)]
    return np.stack(planes, axis=-1)


def subpixel_rays(camera: CameraModel) -> np.ndarray:
    """Directions of every subpixel of a picture, (SUBPIXELS · h, SUBPIXELS · w, 2) float32."""
    u, v = subpixel_centres(camera.width), subpixel_centres(camera.height)
    return directions_on_grid(camera, u, v).astype(np.float32)


def subpixel_centres(pixels: int) -> Array:
    """Where the subpixels of so many pixels in a row are, in pixels."""
    return (np.arange(pixels * SUBPIXELS) + 0.5) / SUBPIXELS - 0.5
