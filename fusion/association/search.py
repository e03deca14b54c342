"""The search for what explains a session: joint hypotheses, pruned by their score.

Visits come in order of time. A camera that was met once constrains nothing, so its visit is left
`open` and costs no branch; at its next visit every pair of modes that agree becomes a hypothesis.
Where none agrees well, what else may have happened is tried: the visit's sightings are wrong, the
camera was moved, the robot was lifted in one of the gaps.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from trigpoint.geometry import Pose
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.rotation import Array

from .events import Events, window
from .graph import Graph, Placed, Tie

# A partial explanation may win back what it lost so far; beyond this none was seen to.
_WINDOW = 2 * window()
_MOST_HYPOTHESES = 64
_MOST_BREAKS = 3
_MOST_PAIRS = 24


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """One explanation of the visits so far.

    `ties`: visits that tie a robot to a place seen more than once; `open`: the only visits to their
    places, by number -> place; `nothing`: visits all of whose sightings are wrong; `breaks`:
    (robot, the node before it was lifted); `placed`: the graph of it; `score`: of all of it.
    """

    ties: dict[int, Tie] = field(default_factory=dict)
    open: dict[int, int] = field(default_factory=dict)
    nothing: frozenset[int] = frozenset()
    breaks: frozenset[tuple[str, int]] = frozenset()
    placed: Placed | None = None
    score: float = 0.0

    def place_of(self, number: int) -> int | None:
        """The place that a visit is of; None where its sightings are wrong."""
        if number in self.ties:
            return self.ties[number].place
        return self.open.get(number)


class Search:
    """Explains the visits of one graph."""

    def __init__(self, graph: Graph, events: Events) -> None:
        self.graph, self.events = graph, events
        self.visits = graph.visits
        self.is_closed = True
        self._open_score = [
            _log_sum([mode.evidence for mode in v.modes]) + events.pose_score for v in self.visits
        ]

    def explained(self, start: Hypothesis, numbers: Iterable[int]) -> list[Hypothesis]:
        """The hypotheses within the window that add these visits, best first."""
        hypotheses = [start]
        for number in numbers:
            grown = [after for before in hypotheses for after in self._with(before, number)]
            hypotheses = self._pruned(grown)
            if not hypotheses:
                return []
        return hypotheses

    def beginning(self) -> Hypothesis:
        """Nothing explained yet."""
        placed = self.graph.placed({}, frozenset())
        return self.scored(Hypothesis(placed=placed))

    def scored(self, hypothesis: Hypothesis) -> Hypothesis:
        """With its score, of what it holds."""
        assert hypothesis.placed is not None
        score = hypothesis.placed.score
        score += sum(self._open_score[number] for number in hypothesis.open)
        score += sum(self.visits[number].nothing for number in hypothesis.nothing)
        score += self.events.move_score * self._moves(hypothesis)
        return replace(hypothesis, score=score)

    def _moves(self, hypothesis: Hypothesis) -> int:
        last: dict[str, int] = {}
        for number, place in [
            *((n, tie.place) for n, tie in hypothesis.ties.items()),
            *hypothesis.open.items(),
        ]:
            camera = self.visits[number].visit.camera
            last[camera] = max(last.get(camera, 0), place)
        return sum(last.values())

    def _pruned(self, grown: list[Hypothesis]) -> list[Hypothesis]:
        grown.sort(key=lambda hypothesis: hypothesis.score)
        near = [h for h in grown if h.score < grown[0].score + _WINDOW]
        if len(near) > _MOST_HYPOTHESES:
            self.is_closed = False
        return near[:_MOST_HYPOTHESES]

    # -- one more visit ---------------------------------------------------------------------------

    def _with(self, before: Hypothesis, number: int) -> list[Hypothesis]:
        """Everything that one more visit may be."""
        visit = self.visits[number]
        wrong = self.scored(replace(before, nothing=before.nothing | {number}))
        if not visit.modes:
            return [wrong]
        mine = self._of_camera(before, visit.visit.camera)
        if not mine and visit.visit.camera in self.graph.data.known.poses:
            joined = self._joined(before, number, 0, [])
            moved = self.scored(replace(before, open=before.open | {number: 1}))
            return [wrong, moved, *joined]
        if not mine:  # whether it is wrong matters once the camera is met again
            return [self.scored(replace(before, open=before.open | {number: 0}))]
        found = [wrong]
        place = max(p for p in (before.place_of(n) for n in mine) if p is not None)
        there = [n for n in mine if before.place_of(n) == place]
        found.append(self.scored(replace(before, open=before.open | {number: place + 1})))
        if len(there) == 1 and there[0] in before.open:
            left = {n: p for n, p in before.open.items() if n != there[0]}
            wrong = before.nothing | {there[0]}
            found.append(self.scored(replace(before, open=left | {number: place}, nothing=wrong)))
        found += self._joined(before, number, place, there)
        return found

    def _of_camera(self, hypothesis: Hypothesis, camera: str) -> list[int]:
        used = [*hypothesis.ties, *hypothesis.open]
        return sorted(n for n in used if self.visits[n].visit.camera == camera)

    def _joined(
        self, before: Hypothesis, number: int, place: int, there: list[int]
    ) -> list[Hypothesis]:
        """The visit at the place that its camera had, by each pair of modes that agrees; with a
        lift before it where none agrees well."""
        pairs = self._pairs(before, number, place, there)
        found = self._tied(before, number, place, there, [p for _, p in pairs], before.breaks)
        alternative = min(
            self.visits[number].nothing, self._open_score[number] + self.events.move_score
        )
        best = min((h.score - before.score for h in found), default=np.inf)
        expected = self._open_score[number] - self.events.pose_score
        if best < expected + self.events.lift_score or best < alternative - _WINDOW:
            return found
        if len(before.breaks) < _MOST_BREAKS:
            found += self._broken(before, number, place, there)
        return found

    def _tied(
        self,
        before: Hypothesis,
        number: int,
        place: int,
        there: list[int],
        pairs: list[tuple[int | None, int]],
        breaks: frozenset[tuple[str, int]],
    ) -> list[Hypothesis]:
        found = []
        for first, second in pairs:
            ties = before.ties | {number: Tie(second, place)}
            opened = before.open
            if first is not None:
                ties = ties | {there[0]: Tie(first, place)}
                opened = {n: p for n, p in opened.items() if n != there[0]}
            placed = self.graph.placed(ties, breaks, before.placed)
            if placed is not None:
                after = replace(before, ties=ties, open=opened, breaks=breaks, placed=placed)
                found.append(self.scored(after))
        return found

    def _broken(
        self, before: Hypothesis, number: int, place: int, there: list[int]
    ) -> list[Hypothesis]:
        """The same after a lift of the robot in each of its gaps since the place was first seen."""
        robot = self.visits[number].visit.robot
        last = self.graph.node_of[number]
        same = [n for n in there if self.visits[n].visit.robot == robot]
        first = self.graph.node_of[min(same)] if same else 0
        gaps = [g for g in range(first, last) if (robot, g) not in before.breaks]
        if not gaps:
            return []
        breaks = before.breaks | {(robot, gaps[-1])}
        loose = self.graph.placed(before.ties, breaks)
        if loose is None:
            return []
        relaxed = replace(before, placed=loose, breaks=breaks)
        pairs = self._pairs(relaxed, number, place, there)
        near = self._tied(relaxed, number, place, there, [p for _, p in pairs], breaks)
        if not near:
            return []
        best = min(h.score for h in near)
        kept = [h for h in near if h.score < best + _WINDOW]
        found = list(kept)
        for gap in gaps[:-1]:
            others = before.breaks | {(robot, gap)}
            for hypothesis in kept:
                placed = self.graph.placed(hypothesis.ties, others)
                if placed is not None:
                    found.append(self.scored(replace(hypothesis, breaks=others, placed=placed)))
        return found

    # -- which modes agree ------------------------------------------------------------------------

    def _pairs(
        self, before: Hypothesis, number: int, place: int, there: list[int]
    ) -> list[tuple[float, tuple[int | None, int]]]:
        """Pairs of modes of the place's only visit (None: the place is held by others) and of the
        new one, with roughly what they cost; the best."""
        assert before.placed is not None
        costs: list[tuple[float, tuple[int | None, int]]] = []
        camera = self.visits[number].visit.camera
        key = camera, place
        news = [self._seen(before.placed, number, m) for m in range(len(self.visits[number].modes))]
        if there and there[0] in before.open:
            olds = [
                (m, self._seen(before.placed, there[0], m))
                for m in range(len(self.visits[there[0]].modes))
            ]
        else:
            rows = before.placed.place_rows[key]
            by = np.zeros((6, len(before.placed.covariance)))
            by[:, rows] = np.eye(6)
            olds = [(None, _Seen(before.placed.places[key], by, np.zeros((6, 6)), 0.0))]
        for first, old in olds:
            for second, new in enumerate(news):
                costs.append((_agreement(old, new, before.placed.covariance), (first, second)))
        costs.sort(key=lambda item: item[0])
        return [item for item in costs[:_MOST_PAIRS] if item[0] < costs[0][0] + _WINDOW]

    def _seen(self, placed: Placed, number: int, mode: int) -> "_Seen":
        """Where a visit's mode puts the camera in the map."""
        visit = self.visits[number]
        relative, information = self.graph.relative(number, mode)
        node = self.graph.node_of[number]
        base = placed.nodes[visit.visit.robot][node]
        pose = base @ relative
        tangent = self.graph.paths[visit.visit.robot].tangent
        by_base = np.eye(6)
        by_base[:3, 3:] = -so3.hat(pose.translation - base.translation)
        by = np.zeros((6, len(placed.covariance)))
        by[:, placed.node_rows[visit.visit.robot][node]] = by_base[:, tangent]
        turn = np.kron(np.eye(2), base.rotation)
        own = turn @ np.linalg.inv(information)[:6, :6] @ turn.T
        return _Seen(pose, by, own, visit.modes[mode].evidence)


@dataclass(frozen=True, slots=True)
class _Seen:
    """A camera's place: pose, derivative by the graph's unknowns, own covariance, evidence."""

    pose: Pose
    by_unknowns: Array
    own: Array
    evidence: float


def _agreement(first: _Seen, second: _Seen, covariance: Array) -> float:
    """-2 ln of how probable it is that both are one place."""
    error = second.pose.difference(first.pose)
    by = second.by_unknowns - first.by_unknowns
    spread = by @ covariance @ by.T + first.own + second.own
    cost = float(error @ np.linalg.solve(spread, error)) + float(np.linalg.slogdet(spread)[1])
    return cost + first.evidence + second.evidence


def _log_sum(scores: list[float]) -> float:
    """-2 ln Σ exp(-score/2)."""
    if not scores:
        return np.inf
    least = min(scores)
    return least - 2 * float(np.log(sum(np.exp(-0.5 * (score - least)) for score in scores)))
