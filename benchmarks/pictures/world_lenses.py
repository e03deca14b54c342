"""Lenses as cameras that watch a room have them: wide, and fisheye to 180 degrees."""

import numpy as np
from msgspec import Struct

from trigpoint.geometry.rotation import Array

_NEWTON_STEPS = 8


class WorldLens(Struct, frozen=True):
    """A ray at an angle t from the axis is `focal_px` (t + bulge t³) from `middle`, pixels. A bulge
    of 1/3 is nearly a lens without distortion, 0 an even fisheye, less than 0 a stronger one."""

    size: tuple[int, int]
    focal_px: float
    bulge: float
    middle: tuple[float, float]

    @classmethod
    def of(
        cls, size: tuple[int, int], diagonal_deg: float, bulge: float, aside: Array
    ) -> "WorldLens":
        """A lens that sees so much from corner to corner; `aside`: (2,) how far its centre is from
        the picture's, of the diagonal."""
        angle, diagonal = np.radians(diagonal_deg) / 2, float(np.hypot(*size))
        focal = diagonal / 2 / (angle + bulge * angle**3)
        x, y = (np.array(size) - 1) / 2 + aside * diagonal
        return cls(size, float(focal), bulge, (float(x), float(y)))

    def project(self, points: Array) -> Array:
        """Pixels (n, 2) of points (n, 3) in the camera's frame."""
        across = np.linalg.norm(points[:, :2], axis=1)
        angle = np.arctan2(across, points[:, 2])
        radius = self.focal_px * (angle + self.bulge * angle**3)
        return np.array(self.middle) + points[:, :2] * (radius / np.maximum(across, 1e-12))[:, None]

    def rays(self, pixels: Array) -> Array:
        """Unit vectors (…, 3) of pixels (…, 2)."""
        flat = (pixels - np.array(self.middle)) / self.focal_px
        radius = np.linalg.norm(flat, axis=-1)
        angle = radius.copy()
        for _ in range(_NEWTON_STEPS):
            error = angle + self.bulge * angle**3 - radius
            angle -= error / np.maximum(1 + 3 * self.bulge * angle**2, 0.1)
        share = np.where(radius > 0, np.sin(angle) / np.maximum(radius, 1e-12), 1.0)
        return np.concatenate([flat * share[..., None], np.cos(angle)[..., None]], axis=-1)
