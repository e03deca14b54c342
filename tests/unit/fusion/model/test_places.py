"""Places near others and ways over squares, held to scipy's."""

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree

from trigpoint.fusion.model.places import are_near, path_lengths


@pytest.mark.parametrize("axes", [2, 3])
@pytest.mark.parametrize("distance_m", [0.05, 0.5, 3.0, 100.0])
def test_near_are_those_that_a_search_of_all_finds(axes: int, distance_m: float) -> None:
    random = np.random.default_rng(axes)
    points, places = random.normal(0, 4, (2000, axes)), random.normal(1, 3, (300, axes))
    nearest, _ = KDTree(places).query(points)
    near = are_near(points, places, distance_m)
    assert near.tolist() == (nearest <= distance_m).tolist()
    assert near.any()


def test_a_place_as_far_as_the_distance_is_near_whatever_rounding_does() -> None:
    points = np.arange(-2000, 2000)[:, None] * [0.1, 0.0]
    for step in ([0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]):
        for point in points[::7]:
            place = point + step
            distance_m = float(np.linalg.norm(place - point))
            assert are_near(point[None], place[None], distance_m * (1 + 1e-15)).all()


def test_nothing_is_near_where_there_is_nothing_or_no_number() -> None:
    here, nowhere = np.zeros((1, 2)), np.zeros((0, 2))
    assert not are_near(here, nowhere, 1.0).any()
    assert are_near(nowhere, here, 1.0).shape == (0,)
    for spoilt in (np.nan, np.inf, -np.inf, 1e300):
        assert not are_near(here, here + spoilt, 1.0).any()
        assert not are_near(here + spoilt, here, 1.0).any()


def squares_of(count: int, side: int) -> np.ndarray:
    """Some squares of a grid, in order."""
    drawn = np.random.default_rng(count).integers(-side, side, (count, 2))
    return np.unique(drawn, axis=0)


@pytest.mark.parametrize(("count", "side"), [(1, 1), (60, 6), (400, 14), (3000, 30)])
def test_ways_are_the_shortest_over_neighbouring_squares(count: int, side: int) -> None:
    squares = squares_of(count, side)
    first, second = KDTree(squares).query_pairs(1.5, output_type="ndarray").T
    steps = np.linalg.norm(squares[first] - squares[second], axis=1)
    graph = coo_array((steps, (first, second)), shape=(len(squares), len(squares)))
    for start in {0, len(squares) // 2, len(squares) - 1}:
        expected = dijkstra(graph, directed=False, indices=start)
        assert path_lengths(squares, start) == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize("start", [-1, 2])
def test_a_way_begins_at_a_square(start: int) -> None:
    with pytest.raises(RuntimeError, match="no such square"):
        path_lengths(np.array([[0, 0], [0, 1]]), start)


@pytest.mark.parametrize("squares", [[[0, 1], [0, 0]], [[0, 0], [0, 0]]])
def test_squares_are_in_order_each_once(squares: list[list[int]]) -> None:
    with pytest.raises(RuntimeError, match="in order"):
        path_lengths(np.array(squares), 0)
