"""How much work the explanation of a session may take: counted, not timed, so that decisions are
the same on every machine and in every run.

A unit is about what one core does in a microsecond. A usual session takes a small part of the
budget for its length; a search that would go on without end is given up when the budget is spent,
and what is undecided then is left undecided.
"""

import math
from collections.abc import Iterable
from typing import Self

from msgspec import Struct

from trigpoint.base.clock import to_seconds
from trigpoint.fusion.model.odometry import OdometryTrack

# A tenth less than `calibrate` is meant to take: ten seconds and a tenth of the session's length.
_AT_LEAST = 9e6
_A_SECOND = 0.09e6
# Where robots look alike, telling them apart may take this share of the budget, and all else as
# much again.
ALIKE_SHARE = 0.55
# All costs are as measured. Solving a visit: for each step, and for each corner in a step;
# assembling it and judging what is wrong cost as much as so many more steps.
_STEP = 150.0
_CORNER = 0.35
_AROUND = 4
# Solving the graphs of hypotheses: for each of them, and for each of its unknowns.
_PLACED = 300.0
_UNKNOWN = 5.0
# Searching starts: for each way to read a single sighting, and for each pair of such ways.
_WAY = 100.0
_PAIR = 0.02
# Filtering a visit for wrong sightings, all filters together: for each part, and for each entry of
# a covariance in it.
_PART = 120.0
_FILTERED = 0.6
# For each view that is judged by itself; and for each view at all, which is read with its visit's
# mode and used in the final solution.
_VIEW = 400.0
_READ = 300.0
# For each picture that is read with a mode while the search goes on.
_COMPLETED = 40.0
# The likelihood of noise: for each evaluation over a visit, for each of its steps, and for each of
# the n² operations of n unknowns that its equations share, a step and an unknown.
_LIKELIHOOD = 50.0
_LINK = 5.0
_LEARNT = 0.0004


class Budget(Struct):
    """`allowed` units of work, and how many are `spent`. Not thread-safe."""

    allowed: float = math.inf
    spent: float = 0.0

    @classmethod
    def of(cls, tracks: Iterable[OdometryTrack], *, share: float = 1.0) -> Self:
        """Return the budget, or a `share` of it, of a session as long as its robots' odometry."""
        ends = [(track.first_ns, track.last_ns) for track in tracks if len(track)]
        if not ends:
            return cls(share * _AT_LEAST)
        first, last = min(first for first, _ in ends), max(last for _, last in ends)
        return cls(share * (_AT_LEAST + _A_SECOND * to_seconds(last - first)))

    @property
    def is_spent(self) -> bool:
        return self.spent >= self.allowed

    def spend_reading(self, *, views: int) -> None:
        """Note the work that grows with the pictures alone: all views are read and solved for."""
        self.spent += _READ * views

    def spend_looking(self) -> None:
        """Note a view that is judged by itself."""
        self.spent += _VIEW

    def spend_completing(self, *, pictures: int) -> None:
        """Note so many pictures that are read with a mode that others of their visit determine."""
        self.spent += _COMPLETED * pictures

    def spend_learning(self, *, steps: int, shared: int) -> None:
        """Note one evaluation of the likelihood of noise over a visit of so many steps, whose
        equations share so many unknowns."""
        self.spent += _LIKELIHOOD + steps * _LINK + _LEARNT * (steps + shared) * shared**2

    def spend_solving(self, *, steps: int, corners: int) -> None:
        """Note the solution of a visit with so many corners in so many steps."""
        self.spent += (steps + _AROUND) * (_STEP + _CORNER * corners)

    def spend_placing(self, *, unknowns: int) -> None:
        """Note the solution of a graph with so many unknowns."""
        self.spent += _PLACED + _UNKNOWN * unknowns

    def spend_starting(self, *, ways: int, seeds: int) -> None:
        """Note a search for starts: so many ways to read sightings, so many of them seeds."""
        self.spent += _WAY * ways + _PAIR * ways * seeds

    def spend_filtering(self, *, parts: int, unknowns: int) -> None:
        """Note the filters over so many parts of a visit with so many unknowns."""
        self.spent += parts * (_PART + _FILTERED * unknowns**2)
