"""What a search kept on its way, so that another one goes on from where both are the same.

What is kept after the first visits depends on these alone: on later ones only in that they may show
the robot's motion between these more precisely. So a search over more visits begins with what the
last one kept after those that have not changed, and one that takes a visit to be wrong with what
was kept before that visit.
"""

from collections.abc import Iterable, Sequence

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from .graph import Factor, Graph, Layout, Placed, Variant
from .hypothesis import Hypothesis

# Of so many last visits everything is kept, of those before only that after every so manieth.
_LAST, _EVERY = 48, 8


class _Stage(Struct, frozen=True):
    """What was kept after some visits: hypotheses without their graphs, and of each of these the
    layout and the poses; by robot, when its nodes were."""

    kept: list[tuple[Hypothesis, Layout, Array]]
    stamps_ns: dict[str, np.ndarray]


class Trail:
    """What a search kept after each of its visits, of which `keys` say what their modes depend on,
    and what they have `shown` of steps; and in the end its `best`, by which the cameras `verified`
    can be nowhere else. Not thread-safe."""

    def __init__(self, graph: Graph, keys: Sequence[object]) -> None:
        self.keys, self.shown = keys, graph.shown
        self._stamps_ns = {robot: path.stamps_ns for robot, path in graph.paths.items()}
        self._stages: dict[int, _Stage] = {}
        self._least: dict[int, float] = {}
        self.best, self.verified = Hypothesis(), frozenset[str]()

    def conclude(self, best: Hypothesis, verified: Iterable[str]) -> None:
        """Note what a search came to after all of its visits."""
        self.best, self.verified = replace(best, placed=None), frozenset(verified)

    def note(self, count: int, hypotheses: list[Hypothesis]) -> None:
        """Note what is kept after the first `count` visits, best first."""
        self._least[count] = hypotheses[0].score
        kept = [
            (replace(each, placed=None), each.placed.layout, each.placed.poses)
            for each in hypotheses
            if each.placed is not None
        ]
        self._stages[count] = _Stage(kept, self._stamps_ns)
        old = count - _LAST
        if old % _EVERY:
            self._stages.pop(old, None)

    def least(self, count: int) -> float:
        """Return the score of the best that was kept after so many visits; inf if not noted."""
        return self._least.get(count, np.inf)

    def take_over(self, other: "Trail", count: int) -> None:
        """Take what another search kept after at most `count` visits, which are the same."""
        self._stages |= {n: stage for n, stage in other._stages.items() if n <= count}

    def same(self, keys: Sequence[object]) -> int:
        """Return how many visits a search over visits with these keys begins with, too."""
        pairs = zip(self.keys, keys, strict=False)
        return next(
            (n for n, (one, other) in enumerate(pairs) if one != other),
            min(len(self.keys), len(keys)),
        )

    def before(self, graph: Graph, count: int) -> tuple[int, list[tuple[Hypothesis, Variant]]]:
        """Return after how many visits, at most `count`, something was noted, and the hypotheses
        that were kept then, as graphs of another search yet to be solved."""
        last = max((n for n in self._stages if n <= count), default=0)
        if not last:
            return 0, []
        stage = self._stages[last]
        return last, [_variant(graph, stage.stamps_ns, *each) for each in stage.kept]


def _variant(
    graph: Graph,
    stamps_ns: dict[str, np.ndarray],
    hypothesis: Hypothesis,
    layout: Layout,
    poses: Array,
) -> tuple[Hypothesis, Variant]:
    """Return a hypothesis of another graph, whose nodes were then, as one of this graph."""
    mine = graph.layout(list(layout.at))
    there = np.concatenate([graph.odometry, poses[list(layout.at.values())]])
    for robot, first in mine.first.items():
        if robot in layout.first:
            known = poses[layout.first[robot] :][: len(stamps_ns[robot])]
            nodes = _nodes(graph, robot, stamps_ns[robot], Pose.from_rows(known))
            there[first : first + len(nodes)] = nodes
    ties, breaks = hypothesis.ties, hypothesis.breaks
    near = Placed(0.0, there, np.zeros(0), ties, breaks, mine, Factor())
    return hypothesis, Variant(ties, hypothesis.nothing, breaks, near)


def _nodes(graph: Graph, robot: str, stamps_ns: np.ndarray, known: Pose) -> Array:
    """Return the rows (n, 12) of a robot's nodes: those that were `known`, and the others by
    odometry from the last of these before them, or the first."""
    path = graph.paths[robot]
    shared = np.flatnonzero(np.isin(path.stamps_ns, stamps_ns))
    if not len(shared):
        return path.odometry.rows()
    nearest = np.searchsorted(shared, np.arange(len(path.stamps_ns)), side="right") - 1
    from_row = shared[np.maximum(nearest, 0)]
    there = known[np.searchsorted(stamps_ns, path.stamps_ns[from_row])]
    return (there @ path.odometry[from_row].inverse() @ path.odometry).rows()
