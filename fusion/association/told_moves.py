"""Moves that cameras told of, and the visits around them."""

from collections.abc import Sequence
from itertools import pairwise

from .graph import Graph
from .hypothesis import Hypothesis
from .mode import VisitModes


def of_camera(hypothesis: Hypothesis, visits: Sequence[VisitModes], camera: str) -> list[int]:
    """Return the numbers of a camera's visits that are right, in order of time."""
    return sorted(n for n in hypothesis.places if visits[n].visit.camera == camera)


class ToldMoves:
    """The moves of a session of which its cameras told (`DataSet.told`): facts, not evidence."""

    def __init__(self, graph: Graph) -> None:
        self._visits, self._told = graph.visits, graph.data.told

    def is_between(self, earlier: int | None, later: int) -> bool:
        """Return whether the camera of two visits told that it was moved between them; None:
        before all visits."""
        visit = self._visits[later].visit
        until_ns = -1 if earlier is None else self._visits[earlier].visit.until_ns
        return any(
            until_ns <= move.until_ns and move.since_ns <= visit.stamp_ns
            for move in self._told
            if move.camera == visit.camera
        )

    def is_during(self, number: int) -> bool:
        """Return whether a visit was while its camera was being moved."""
        visit = self._visits[number].visit
        return any(
            move.until_ns < visit.stamp_ns and visit.until_ns < move.since_ns
            for move in self._told
            if move.camera == visit.camera
        )

    def count_in(self, hypothesis: Hypothesis) -> int:
        """Return the number of moves in a hypothesis of which cameras told."""
        count = 0
        for camera in {move.camera for move in self._told}:
            numbers = of_camera(hypothesis, self._visits, camera)
            places = [hypothesis.place_of(number) for number in numbers]
            if numbers and places[0]:  # known from before, and elsewhere then
                count += self.is_between(None, numbers[0])
            steps = zip(pairwise(numbers), pairwise(places), strict=True)
            count += sum(old != new and self.is_between(*pair) for pair, (old, new) in steps)
        return count
