"""How well robots are corrected where, as a picture that lies over the page's floor."""

import zlib

import numpy as np
from msgspec import Struct

from trigpoint.geometry import Pose
from trigpoint.tools.pages.floor_plan import picture_matrix, png

from .entities import Fields

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
