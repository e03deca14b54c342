"""Where the search for a graph's minimum starts."""

from dataclasses import replace

import numpy as np
import pytest
from support.oracle.sessions import Shape, graph_of

from trigpoint.fusion.association.graph import Graph, Tie, Variant
from trigpoint.fusion.association.initial_values import initial_values
from trigpoint.fusion.association.minimum import placed
from trigpoint.geometry import Pose

NOWHERE = frozenset[tuple[str, int]]()
LIFT = frozenset({("r1", 1)})


@pytest.fixture
def graph() -> Graph:
    """Of c1, c2 and c1 again."""
    return graph_of(Shape(0, (0, 1, 0), is_alike=False))


def met_again(breaks: frozenset[tuple[str, int]] = NOWHERE) -> Variant:
    return Variant({0: Tie(0, 0), 2: Tie(0, 0)}, frozenset(), breaks)


def test_along_odometry_where_it_is_near_nothing(graph: Graph) -> None:
    nodes, places = initial_values(graph, met_again())
    odometry = graph.paths["r1"].odometry
    assert np.allclose(nodes["r1"].translation, odometry.translation)
    seen = graph.relative(0)[0][0]
    assert np.allclose(places["c1", 0].difference(odometry[graph.node_of[0]] @ seen), 0.0)


def test_what_it_is_near_is_where_it_starts(graph: Graph) -> None:
    (near,) = placed(graph, [met_again()])
    assert near is not None
    nodes, places = initial_values(graph, replace(met_again(), near=near))
    assert np.allclose(nodes["r1"].translation, near.nodes["r1"].translation)
    assert places["c1", 0] is near.places["c1", 0]


def test_after_a_lift_a_robot_is_where_its_next_tie_puts_it(graph: Graph) -> None:
    (near,) = placed(graph, [met_again()])
    assert near is not None
    turned = near.nodes["r1"]
    last = graph.node_of[2]
    away = Pose.planar(3.0, -2.0, 2.0)
    off = Pose(turned.rotation.copy(), turned.translation.copy())
    off.rotation[last:] = (away @ turned[last:]).rotation
    off.translation[last:] = (away @ turned[last:]).translation
    nodes, _ = initial_values(
        graph, replace(met_again(LIFT), near=replace(near, nodes={"r1": off}, breaks=LIFT))
    )
    assert np.allclose(nodes["r1"][last].difference(turned[last]), 0.0, atol=0.1)
    assert np.allclose(nodes["r1"][0].difference(turned[0]), 0.0)


def test_without_the_lift_of_what_it_is_near_odometry_holds_again(graph: Graph) -> None:
    (near,) = placed(graph, [met_again(LIFT)])
    assert near is not None
    nodes, _ = initial_values(graph, replace(met_again(), near=near))
    assert np.allclose(nodes["r1"].translation, graph.paths["r1"].odometry.translation)


@pytest.mark.parametrize("breaks", [NOWHERE, LIFT])
def test_start_does_not_say_what_the_minimum_is(
    graph: Graph, breaks: frozenset[tuple[str, int]]
) -> None:
    (alone,) = placed(graph, [met_again(breaks)])
    assert alone is not None
    by = np.array([0.3, -0.2, 0.0, 0.0, 0.0, 0.1])
    off = {robot: nodes.disturbed(by) for robot, nodes in alone.nodes.items()}
    away = replace(alone, nodes=off, places={k: p.disturbed(by) for k, p in alone.places.items()})
    (beside,) = placed(graph, [replace(met_again(breaks), near=away)])
    assert beside is not None
    assert beside.score == pytest.approx(alone.score, abs=2e-3)
