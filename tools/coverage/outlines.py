"""Outlines of cells of a grid as polygons, along the cells' sides."""

from collections import defaultdict

import numpy as np

from trigpoint.geometry.rotation import Array

Corner = tuple[int, int]
# A cell's sides, counter-clockwise: the neighbour beyond it (row, column), and its start and end
# (column, row).
_SIDES = (
    ((-1, 0), (0, 0), (1, 0)),
    ((0, 1), (1, 0), (1, 1)),
    ((1, 0), (1, 1), (0, 1)),
    ((0, -1), (0, 1), (0, 0)),
)


def outlines(cells: np.ndarray) -> list[list[Array]]:
    """The areas that cells (rows, columns) bool form, each a polygon: its outer ring, counter-
    clockwise, then its holes, clockwise. A ring is (n, 2), closed, in cells from the lower left
    corner, x then y."""
    rings = _rings(cells)
    outer = [ring for ring in rings if _area(ring) > 0]
    polygons = [[ring] for ring in outer]
    for hole in (ring for ring in rings if _area(ring) < 0):
        around = [index for index, ring in enumerate(outer) if _holds(ring, _beside(hole))]
        polygons[min(around, key=lambda index: _area(outer[index]))].append(hole)
    return polygons


def _rings(cells: np.ndarray) -> list[Array]:
    """All rings, with the cells to their left."""
    onwards = _sides(cells)
    rings = []
    for start in onwards:
        while onwards[start]:
            ring = [start, onwards[start].pop()]
            while ring[-1] != start:
                ring.append(_next(ring[-2], ring[-1], onwards[ring[-1]]))
            rings.append(_without_straights(np.array(ring)))
    return rings


def _sides(cells: np.ndarray) -> dict[Corner, list[Corner]]:
    """From each corner, the sides that begin there and have no cell beyond."""
    padded = np.pad(cells, 1)
    onwards: dict[Corner, list[Corner]] = defaultdict(list)
    for (down, right), (x0, y0), (x1, y1) in _SIDES:
        beyond = padded[
            1 + down : 1 + down + cells.shape[0], 1 + right : 1 + right + cells.shape[1]
        ]
        for row, column in np.argwhere(cells & ~beyond).tolist():
            onwards[column + x0, row + y0].append((column + x1, row + y1))
    return onwards


def _next(before: Corner, here: Corner, ends: list[Corner]) -> Corner:
    """Where a ring goes on; where two cells touch by a corner, it stays with its own: it turns
    left."""
    step = (here[0] - before[0], here[1] - before[1])
    left = (here[0] - step[1], here[1] + step[0])
    chosen = left if left in ends else ends[0]
    ends.remove(chosen)
    return chosen


def _without_straights(ring: Array) -> Array:
    steps = np.diff(ring, axis=0)
    turns = np.any(steps != np.roll(steps, 1, axis=0), axis=1)
    kept = ring[:-1][turns]
    return np.vstack([kept, kept[:1]])


def _area(ring: Array) -> float:
    """Positive where it runs counter-clockwise."""
    x, y = ring[:-1].T, ring[1:].T
    return 0.5 * float(np.sum(x[0] * y[1] - y[0] * x[1]))


def _beside(ring: Array) -> Array:
    """The middle of the cell to the left of a ring's first side, (2,)."""
    along = np.sign(ring[1] - ring[0])
    return ring[0] + 0.5 * along + 0.5 * np.array([-along[1], along[0]])


def _holds(ring: Array, point: Array) -> bool:
    (x0, y0), (x1, y1) = ring[:-1].T, ring[1:].T
    crosses = (y0 > point[1]) != (y1 > point[1])
    at = x0 + (point[1] - y0) * (x1 - x0) / np.where(y1 == y0, 1.0, y1 - y0)
    return bool(np.sum(crosses & (at > point[0])) % 2)
