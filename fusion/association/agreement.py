"""Which modes of two visits put a camera at one place, judged before solving each pair's graph."""

import numpy as np
from msgspec import Struct

from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import lever, turned_axes
from trigpoint.native.library import In, Kernel, Out

from .graph import Factor, Graph, Place, Placed

_REAL = np.float64
AGREEMENT = Kernel(
    "tp_agreement",
    Factor,
    *(In(_REAL, (1, 12)), In(np.int64, (6,)), In(_REAL, ("k", 12)), In(_REAL, ("k", 6, 6))),
    In(_REAL, ("k",)),
    *(In(_REAL, (1, 12)), In(np.int64, (6,)), In(_REAL, ("m", 12)), In(_REAL, ("m", 6, 6))),
    *(In(_REAL, ("m",)), In(_REAL, (6, 6)), Out(_REAL, ("k", "m"))),
)
_THERE = Pose.identity().rows()
_EXACTLY, _NO_EVIDENCE = np.zeros((1, 6, 6)), np.zeros(1)
_APART = np.zeros((6, 6))


class Seen(Struct, frozen=True):
    """Where the modes (k) of a visit put their camera in the map: `pose` (k), with the covariance
    `own` (k, 6, 6) that the modes add to that of the unknowns in `rows` (r,), by which its
    derivative is `by_unknowns` (k, 6, r)."""

    pose: Pose
    by_unknowns: Array
    rows: np.ndarray
    own: Array


def agreement(
    graph: Graph,
    placed: Placed,
    first: int | Place,
    second: int | Place,
    beside: Array = _APART,
) -> Array:
    """Return, for each pair of modes (k, m), -2 ln of the likelihood that both show one place, or
    two places whose difference has the covariance `beside` (6, 6).

    `first`, `second`: the number of a visit, or a place of the graph, which counts as one mode.
    Raises RuntimeError where nothing determines the two poses.
    """
    old, new = (_given(graph, placed, each) for each in (first, second))
    cost = np.empty((len(old[-1]), len(new[-1])))
    AGREEMENT(placed.factor, *old, *new, beside, cost)
    return cost


def _given(graph: Graph, placed: Placed, which: int | Place) -> tuple[np.ndarray, ...]:
    """A pose of the graph, its rows (6,), -1 where it is held, and where the modes (k) put the
    camera from there, with their covariances and evidence."""
    if not isinstance(which, int):
        rows = placed.layout.places[which]
        return placed.poses[[placed.layout.at[which]]], rows, _THERE, _EXACTLY, _NO_EVIDENCE
    robot, node, modes = graph.visits[which].visit.robot, graph.node_of[which], graph.modes[which]
    rows = np.full(6, -1)
    rows[graph.paths[robot].tangent] = placed.layout.nodes[robot][node]
    return (
        *(placed.poses[[placed.layout.first[robot] + node]], rows, modes.base_from_camera.rows()),
        *(modes.covariance, modes.evidence),
    )


def seen_by(graph: Graph, placed: Placed, number: int) -> Seen:
    """Return where the modes of a visit put its camera, given the graph's estimate."""
    robot, node = graph.visits[number].visit.robot, graph.node_of[number]
    base, tangent = placed.node(robot, node), graph.paths[robot].tangent
    pose = base @ graph.modes[number].base_from_camera
    by_base = lever(pose.translation - base.translation)
    turn = turned_axes(base.rotation)
    own = turn @ graph.modes[number].covariance @ turn.T
    return Seen(pose, by_base[..., tangent], placed.layout.nodes[robot][node], own)
