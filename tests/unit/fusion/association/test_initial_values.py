"""Where the search for a graph's minimum starts."""

import numpy as np
import pytest
from msgspec.structs import replace
from support.oracle.sessions import Shape, graph_of

from trigpoint.fusion.association.graph import Graph, Layout, Placed, Tie, Variant
from trigpoint.fusion.association.minimum import Minima, initial_poses
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

NOWHERE = frozenset[tuple[str, int]]()
LIFT = frozenset({("r1", 1)})


@pytest.fixture
def graph() -> Graph:
    """Of c1, c2 and c1 again."""
    return graph_of(Shape(0, (0, 1, 0), is_alike=False))


def met_again(breaks: frozenset[tuple[str, int]] = NOWHERE) -> Variant:
    return Variant({0: Tie(0, 0), 2: Tie(0, 0)}, frozenset(), breaks)


def solved(graph: Graph, variant: Variant) -> Placed:
    found = Minima(graph).placed(variant)
    assert found is not None
    return found


def begun(graph: Graph, layout: Layout, variant: Variant) -> Array:
    """The poses with which a variant whose ties are all of c1 begins."""
    ties = sorted(variant.ties.items())
    ends = np.array([[graph.node_of[n], layout.at["c1", 0], -1, 0] for n, _ in ties])
    seen = np.concatenate([graph.modes[n].base_from_camera.rows()[[tie.mode]] for n, tie in ties])
    return initial_poses(graph, layout, variant, ties, ends, seen)


def started(graph: Graph, variant: Variant) -> tuple[Pose, Pose]:
    """Where the robot's nodes and the camera begin."""
    poses = begun(graph, graph.layout([("c1", 0)]), variant)
    return Pose.from_rows(poses[:-1]), Pose.from_rows(poses[-1])


def test_along_odometry_where_it_is_near_nothing(graph: Graph) -> None:
    nodes, camera = started(graph, met_again())
    odometry = graph.paths["r1"].odometry
    assert np.allclose(nodes.translation, odometry.translation)
    seen = graph.modes[0].base_from_camera[0]
    assert np.allclose(camera.difference(odometry[graph.node_of[0]] @ seen), 0.0)


def test_what_it_is_near_is_where_it_starts(graph: Graph) -> None:
    near = solved(graph, met_again())
    poses = begun(graph, near.layout, replace(met_again(), near=near))
    assert np.array_equal(poses, near.poses)


def test_after_a_lift_a_robot_is_where_its_next_tie_puts_it(graph: Graph) -> None:
    near = solved(graph, met_again())
    turned, last = Pose.from_rows(near.poses[:-1]), graph.node_of[2]
    off = near.poses.copy()
    off[last:-1] = (Pose.planar(3.0, -2.0, 2.0) @ turned[last:]).rows()
    before = replace(near, poses=off, breaks=LIFT, ties={0: Tie(0, 0)})
    nodes, _ = started(graph, replace(met_again(LIFT), near=before))
    assert np.allclose(nodes[last].difference(turned[last]), 0.0, atol=0.1)
    assert np.allclose(nodes[0].difference(turned[0]), 0.0)


def test_without_the_lift_of_what_it_is_near_odometry_holds_again(graph: Graph) -> None:
    near = solved(graph, met_again(LIFT))
    nodes, _ = started(graph, replace(met_again(), near=near))
    assert np.allclose(nodes.translation, graph.paths["r1"].odometry.translation)


@pytest.mark.parametrize("breaks", [NOWHERE, LIFT])
def test_start_does_not_say_what_the_minimum_is(
    graph: Graph, breaks: frozenset[tuple[str, int]]
) -> None:
    alone = solved(graph, met_again(breaks))
    by = np.array([0.3, -0.2, 0.0, 0.0, 0.0, 0.1])
    away = replace(alone, poses=Pose.from_rows(alone.poses).disturbed(by).rows())
    beside = solved(graph, replace(met_again(breaks), near=away))
    assert beside.score == pytest.approx(alone.score, abs=2e-3)
