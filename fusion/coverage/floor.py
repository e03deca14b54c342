"""The floor in square cells, and the part of it that is known to be floor."""

import math
from collections.abc import Iterator, Sequence

import numpy as np
from msgspec import Struct

from trigpoint.fusion.model.places import are_near
from trigpoint.fusion.reading.sight import information_at
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.samples import unique

from .known_network import Carried, KnownNetwork

CELL_M = 0.1
DRIVEN_M = 0.5
"""Floor is where a robot drove, and so far about it; and where a camera would see one."""
HEADINGS = 8
_COARSE_M = 0.5
_COARSE_HEADINGS = 6
_TILE = 32  # cells
_LARGEST_M = 2000.0
"""A side of the floor; a network that is wider has a camera that is not where it should be."""


class Floor(Struct, frozen=True):
    """`origin`: the lower left corner, (x, y) in the map; a cell's side `cell_m`; how many `rows`
    (along y) and `columns` (along x). Cells are counted row by row from there."""

    origin: tuple[float, float]
    cell_m: float
    rows: int
    columns: int

    @property
    def area_m2(self) -> float:
        """Of one cell."""
        return self.cell_m**2

    @property
    def centres(self) -> Array:
        """The middles of all cells, (rows · columns, 2)."""
        x = self.origin[0] + (np.arange(self.columns) + 0.5) * self.cell_m
        y = self.origin[1] + (np.arange(self.rows) + 0.5) * self.cell_m
        return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)

    def tiles(self) -> Iterator[np.ndarray]:
        """The cells' numbers in squares of neighbours."""
        numbers = np.arange(self.rows * self.columns).reshape(self.rows, self.columns)
        for row in range(0, self.rows, _TILE):
            for column in range(0, self.columns, _TILE):
                yield numbers[row : row + _TILE, column : column + _TILE].reshape(-1)

    def near(self, places: Array, within_m: float) -> np.ndarray:
        """Which cells' middles are within so much of places (n, 2); (cells,) bool."""
        return are_near(self.centres, places, within_m)


def floor_of(
    network: KnownNetwork,
    carried: tuple[Carried, ...],
    driven: Array,
    *,
    cell_m: float = CELL_M,
    most_cells: int | None = None,
) -> Floor:
    """The floor about everything that a camera may see and about where robots drove (n, 2).

    With `most_cells` the cells are larger, by a whole number, where there would be more.
    """
    parts = [driven]
    for each in carried:
        parts += _seen_coarsely(network, each)
    return floor_about(np.concatenate(parts), cell_m=cell_m, most_cells=most_cells)


def headings_rad(count: int = HEADINGS) -> Array:
    """So many headings, evenly around, (count,)."""
    return np.arange(count) * 2 * np.pi / count


def standing(places: Array, headings: int = HEADINGS) -> Pose:
    """A robot at places (n, 2), in each of so many headings, (n · headings)."""
    x, y = np.repeat(places, headings, axis=0).T
    return Pose.planar(x, y, np.tile(headings_rad(headings), len(places)))


def each_decimetre(places: Sequence[Array]) -> Array:
    """Where robots were, (n, 2), each decimetre once; `places`: parts (m, 2 or 3)."""
    flat = np.concatenate([np.zeros((0, 2)), *(part[:, :2] for part in places)])
    return unique(np.round(flat, 1), axis=0)


def floor_about(places: Array, *, cell_m: float = CELL_M, most_cells: int | None = None) -> Floor:
    """The floor about places (n, 2), to half a metre beyond them; no cells where there is none.
    `most_cells`: as above."""
    if not len(places):
        return Floor((0.0, 0.0), cell_m, 0, 0)
    low, high = places.min(axis=0) - DRIVEN_M, places.max(axis=0) + DRIVEN_M
    size = np.minimum(high - low, _LARGEST_M)
    if most_cells is not None:
        cell_m *= max(1, math.ceil(math.sqrt(float(size.prod()) / cell_m**2 / most_cells)))
    x, y = (math.floor(float(value) / cell_m) for value in low)
    columns, rows = (math.ceil(float(value) / cell_m) + 1 for value in size)
    return Floor((x * cell_m, y * cell_m), cell_m, rows, columns)


def _seen_coarsely(network: KnownNetwork, carried: Carried) -> Iterator[Array]:
    """For each camera, places (n, 2) about which it may see a robot."""
    for eye in network.eyes:
        _, reach, square = carried.faces.ball
        far = min(eye.reach_m(square) + reach, _LARGEST_M / 2)
        count = math.ceil(far / _COARSE_M)
        steps = np.arange(-count, count + 1) * _COARSE_M
        around = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
        places = around + eye.map_from_camera.translation[:2]
        places = places[eye.may_see(carried.faces, places)]
        told = information_at(eye, carried.faces, standing(places, _COARSE_HEADINGS))
        yield places[unique(told.rows // _COARSE_HEADINGS)]
