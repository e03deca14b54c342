"""Which modes of two visits put a camera at one place, judged before solving each pair's graph."""

from dataclasses import dataclass

import numpy as np

from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import lever, turned_axes

from .graph import Graph, Place, Placed


@dataclass(frozen=True, slots=True)
class Seen:
    """Where the modes (k) of a visit put their camera in the map.

    `by_unknowns` (k, 6, r): the derivative of `pose` (k) by the graph's unknowns in `rows` (r,);
    `own` (k, 6, 6): the covariance that the modes add to that of these unknowns; `evidence` (k,):
    of each mode (`Mode.evidence`).
    """

    pose: Pose
    by_unknowns: Array
    rows: np.ndarray
    own: Array
    evidence: Array


def agreement(
    graph: Graph,
    placed: Placed,
    first: int | Place,
    second: int | Place,
    beside: Array | float = 0.0,
) -> Array:
    """Return, for each pair of modes (k, m), -2 ln of the likelihood that both show one place, or
    two places whose difference has the covariance `beside` (6, 6).

    `first`, `second`: the number of a visit, or a place of the graph, which counts as one mode.
    """
    old, new = (
        seen_by(graph, placed, each) if isinstance(each, int) else _known(placed, each)
        for each in (first, second)
    )
    rows = np.concatenate([old.rows, new.rows])
    shared = placed.covariance(rows)
    count, other = len(old.evidence), len(new.evidence)
    by = np.concatenate(
        [
            np.tile(-old.by_unknowns[:, None], (1, other, 1, 1)),
            np.tile(new.by_unknowns[None], (count, 1, 1, 1)),
        ],
        axis=-1,
    )
    spread = by @ shared @ np.swapaxes(by, -1, -2) + old.own[:, None] + new.own[None] + beside
    error = Pose(new.pose.rotation[None], new.pose.translation[None]).difference(
        Pose(old.pose.rotation[:, None], old.pose.translation[:, None])
    )
    pulled = np.linalg.solve(spread, error[..., None])[..., 0]
    cost = np.sum(error * pulled, axis=-1) + np.linalg.slogdet(spread)[1]
    return cost + old.evidence[:, None] + new.evidence[None]


def seen_by(graph: Graph, placed: Placed, number: int) -> Seen:
    """Return where the modes of a visit put its camera, given the graph's estimate."""
    visit = graph.visits[number]
    robot, node = visit.visit.robot, graph.node_of[number]
    base, tangent = placed.nodes[robot][node], graph.paths[robot].tangent
    pose = base @ graph.relative(number)[0]
    by_base = lever(pose.translation - base.translation)
    turn = turned_axes(base.rotation)
    evidence = np.array([mode.evidence for mode in visit.modes])
    own = turn @ graph.spread(number) @ turn.T
    return Seen(pose, by_base[..., tangent], placed.layout.nodes[robot][node], own, evidence)


def _known(placed: Placed, place: Place) -> Seen:
    pose = placed.places[place]
    return Seen(
        Pose.stack([pose]),
        np.eye(6)[None],
        placed.layout.places[place],
        np.zeros((1, 6, 6)),
        np.zeros(1),
    )
