"""Outlines of cells, against the cells themselves."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from trigpoint.geometry.rotation import Array
from trigpoint.tools.coverage.outlines import outlines


def area(ring: Array) -> float:
    (x, y), (x1, y1) = ring[:-1].T, ring[1:].T
    return 0.5 * float(np.sum(x * y1 - y * x1))


def holds(ring: Array, x: float, y: float) -> bool:
    inside = False
    for (x0, y0), (x1, y1) in zip(ring[:-1].tolist(), ring[1:].tolist(), strict=True):
        if (y0 > y) != (y1 > y) and x0 + (y - y0) * (x1 - x0) / (y1 - y0) > x:
            inside = not inside
    return inside


@given(arrays(bool, st.tuples(st.integers(1, 7), st.integers(1, 7))))
def test_polygons_hold_the_cells_and_nothing_else(cells: np.ndarray) -> None:
    polygons = outlines(cells)
    for polygon in polygons:
        assert all(np.array_equal(ring[0], ring[-1]) for ring in polygon)
        assert area(polygon[0]) > 0
        assert all(area(hole) < 0 for hole in polygon[1:])
    assert sum(area(ring) for polygon in polygons for ring in polygon) == cells.sum()
    for (row, column), is_in in np.ndenumerate(cells):
        x, y = column + 0.5, row + 0.5
        count = sum(
            holds(outer, x, y) and not any(holds(hole, x, y) for hole in holes)
            for outer, *holes in polygons
        )
        assert count == int(is_in)


def test_a_ring_around_a_hole_is_one_polygon_with_corners_alone() -> None:
    cells = np.ones((5, 6), dtype=bool)
    cells[1:3, 2:4] = False
    [[outer, hole]] = outlines(cells)
    assert len(outer) == len(hole) == 5
    assert (area(outer), area(hole)) == (30.0, -4.0)
