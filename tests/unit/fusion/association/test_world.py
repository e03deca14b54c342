"""What hangs on one gap of odometry alone."""

from support.oracle.sessions import Shape, graph_of

from trigpoint.fusion.association.graph import Tie
from trigpoint.fusion.association.world import tied_twice


def test_loop_that_closes_ties_everything_on_it_and_nothing_after() -> None:
    graph = graph_of(Shape(0, (0, 1, 0, 2), is_alike=False))
    tied = tied_twice(graph, {0: Tie(0, 0), 2: Tie(0, 0)}, {1: 0, 3: 0}, frozenset())
    assert ("c1", 0) in tied
    assert ("c2", 0) in tied  # either way round the loop
    assert ("c3", 0) not in tied


def test_without_a_loop_only_where_the_map_begins_is_sure() -> None:
    graph = graph_of(Shape(0, (0, 1), is_alike=False))
    assert {
        spot for spot in tied_twice(graph, {}, {0: 0, 1: 0}, frozenset()) if "c" in spot[0]
    } == {("c1", 0)}
