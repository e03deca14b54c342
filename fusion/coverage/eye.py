"""A located camera, and what bounds what it can see, so that most places need no closer look."""

from functools import cached_property

import numpy as np
from msgspec import Struct

from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array

from .boards import Carried

LEAST_SIDE_PX = 7.0
MARGIN_PX = 5.0
_SAMPLES = 17


class Eye(Struct, frozen=True, eq=False, dict=True):
    """A located camera; `sigma_px`: of a corner's coordinate in its pictures."""

    name: str
    map_from_camera: Pose
    lens: CameraModel
    sigma_px: float

    @cached_property
    def widest_rad(self) -> float:
        """The angle between the optical axis and the picture's farthest edge."""
        right, bottom = self.lens.width - 0.5, self.lens.height - 0.5
        angles = self._angles([[-0.5, -0.5], [right, -0.5], [right, bottom], [-0.5, bottom]])
        # Where the lens cannot be inverted (a fisheye's edge), half of all directions.
        return float(angles.max()) if np.all(np.isfinite(angles)) else np.pi / 2

    @cached_property
    def narrowest_rad(self) -> float:
        """The angle from the optical axis within which everything lies well in the picture; 0 where
        the lens does not say."""
        right, bottom = self.lens.width - 1 - MARGIN_PX, self.lens.height - 1 - MARGIN_PX
        share = np.linspace(0.0, 1.0, 4 * _SAMPLES)[:, None]
        ends = np.array(
            [[MARGIN_PX, MARGIN_PX], [right, MARGIN_PX], [right, bottom], [MARGIN_PX, bottom]]
        )
        around = np.concatenate(
            [a + share * (b - a) for a, b in zip(ends, np.roll(ends, -1, axis=0), strict=True)]
        )
        angles = self._angles(around)
        return float(angles.min()) if np.all(np.isfinite(angles)) else 0.0

    @cached_property
    def scale_px(self) -> tuple[float, float]:
        """How large a metre across the line of sight, at a metre's distance, is in the picture at
        least and at most, pixels."""
        u, v = (
            np.linspace(0, side - 1.0, _SAMPLES) for side in (self.lens.width, self.lens.height)
        )
        ways = self.lens.directions(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))
        ways = ways[np.all(np.isfinite(ways), axis=1)]
        rays = np.column_stack([ways, np.ones(len(ways))])
        _, by_point = self.lens.project_by_point(rays / np.linalg.norm(rays, axis=1)[:, None])
        sizes = np.linalg.svd(by_point, compute_uv=False)
        return float(sizes.min()), float(sizes.max())

    def reach_m(self, square_m: float) -> float:
        """From farther away no square of this size is large enough."""
        return self.scale_px[1] * square_m / LEAST_SIDE_PX

    def may_see(self, carried: Carried, places: Array) -> np.ndarray:
        """False where a robot at places (n, 2) shows it nothing, whatever its heading; (n,)."""
        height, reach, square = carried.ball
        centres = np.column_stack([places, np.full(len(places), height)])
        offset = (centres - self.map_from_camera.translation) @ self.map_from_camera.rotation
        distance = np.maximum(np.linalg.norm(offset, axis=1), 1e-9)
        off_axis = np.arccos(np.clip(offset[:, 2] / distance, -1, 1))
        within = np.arcsin(np.minimum(reach / distance, 1.0))
        is_near = distance - reach <= self.reach_m(square)
        return is_near & ((distance <= reach) | (off_axis - within < self.widest_rad))

    def shows(self, points: Array) -> np.ndarray:
        """Which points (…, 3) of the optical frame lie in the picture, off its edge; (…) bool."""
        return self.lens.sees(points, margin_px=MARGIN_PX)

    def _angles(self, pixels: Array | list[list[float]]) -> Array:
        """The angles of pixels (n, 2) from the optical axis, radians; NaN where unknown."""
        return np.arctan(np.linalg.norm(self.lens.directions(pixels), axis=-1))
