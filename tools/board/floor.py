"""What lies under the page's map: the floor plan, and how well robots are corrected where."""

import zlib
from collections.abc import Sequence

import numpy as np
from msgspec import Struct

from trigpoint.base.errors import InputError
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.map.building import load_plan
from trigpoint.map.live_laying import LiveLaying
from trigpoint.site.config import Site
from trigpoint.tools.pages.floor_plan import picture_matrix, png

from .entities import Fields

_SHADES = 16
_MOST_PIXELS = 1200
"""A side; walls are still seen, and the picture of a hall has some tens of kilobytes."""


class Floor:
    """Raises ConfigError where the site's plan cannot be read. `picture`: PNG; "" without one."""

    def __init__(self, site: Site) -> None:
        plan = load_plan(site)
        self._is_surveyed = site.map is not None and bool(site.map.points)
        self._plan = None if plan is None else plan.reduced(_MOST_PIXELS)
        self._laying = LiveLaying(site.map, plan)
        self._building = self._laying.given()
        self._trouble = ""
        self.picture = b"" if self._plan is None else png(self._plan.pixels, colours=_SHADES)

    def take(
        self, entities: Sequence[str], poses: Pose, covariances: Array, stamps_ns: Sequence[int]
    ) -> None:
        """Take poses (n) of cameras or robots, by which the map may be laid anew, with their
        covariances (n, 6, 6)."""
        if not self._is_surveyed:
            return
        places = zip(entities, poses.translation, covariances[:, :3, :3], stamps_ns, strict=True)
        for entity, place, covariance, stamp_ns in places:
            kind, _, name = entity.partition("/")
            if kind == "camera":
                self._laying.take_camera(name, place, covariance)
            else:
                self._laying.take_robot(name, stamp_ns, place, covariance)
        laid = self._laying.laid(max(stamps_ns))
        if isinstance(laid, InputError):
            self._trouble = str(laid)
        elif laid is not None:
            self._building, self._trouble = laid, ""

    @property
    def fields(self) -> Fields:
        """`matrix`: the picture's columns and rows to x, y of the map, as SVG orders them."""
        found: Fields = {"trouble": self._trouble}
        if self._plan is not None and self._building is not None:
            rows, columns = self._plan.pixels.shape
            corners = self._building.frame_from_map.inverse() @ self._plan.corners
            matrix = picture_matrix(corners[:, :2], columns, rows)
            found |= {"size": [columns, rows], "matrix": [round(value, 6) for value in matrix]}
        return found


_BEST, _WORST = np.array([28, 122, 90]), np.array([179, 38, 30])
_ALPHA = 120
_MOST_CELLS = 16_000_000


class GridPicture(Struct, frozen=True):
    """`png`: green where robots are corrected best, red where not at all, clear where unknown;
    `fields`: where it lies."""

    png: bytes
    fields: Fields


def grid_picture(cell_m: float, map_from_grid: Pose, values: np.ndarray) -> GridPicture | None:
    """Of `values` (rows, columns), 0 best to 100 worst, below 0 unknown, row by row from the corner
    at `map_from_grid`; None of one that is empty or larger than any hall."""
    rows, columns = values.shape
    if not 0 < values.size <= _MOST_CELLS:
        return None
    share = np.clip(values[::-1, :, None] / 100, 0.0, 1.0)
    colour = np.empty((rows, columns, 4), dtype=np.uint8)
    colour[..., :3] = np.rint((1 - share) * _BEST + share * _WORST)
    colour[..., 3] = np.where(values[::-1] < 0, 0, _ALPHA)
    data, width, height = png(colour), columns * cell_m, rows * cell_m
    rim = [[0.0, 0, 0], [width, 0, 0], [width, height, 0], [0, height, 0]]
    matrix = picture_matrix((map_from_grid @ np.array(rim))[:, :2], columns, rows)
    fields: Fields = {
        "matrix": [round(value, 6) for value in matrix],
        "size": [columns, rows],
        "version": f"{zlib.crc32(data):08x}",
    }
    return GridPicture(data, fields)
