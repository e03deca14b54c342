"""How much work a session may take to be explained: counted, not timed, so that what is decided is
the same on every machine and in every run.

A unit is about what one core does in a microsecond. The work of a usual session is a small part of
what one of its length may take; where it would go on without an end it is given up there, and what
is still open is left open.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Self

from trigpoint.clock import to_seconds
from trigpoint.fusion.model.odometry import OdometryTrack

# A fifth more than `calibrate` is meant to take: ten seconds, and a tenth of the session.
_AT_LEAST = 12e6
_A_SECOND = 0.12e6
# Where robots look alike, telling them apart may take this share of it, and all else as much.
ALIKE_SHARE = 5 / 6
# As measured. Of a visit's solution: a step, and a corner in it; assembling it and judging what is
# wrong by it are as much as so many steps.
_STEP = 1200.0
_CORNER = 1.2
_AROUND = 3
# Of where hypotheses put everything: those of one layout together, each of them, and a number of a
# dense factor's arithmetic, or an unknown of a sparse one.
_LAYOUT = 3000.0
_PLACED = 100.0
_NUMBER = 0.0004
_UNKNOWN = 6.0
# Of starts: a way to read a sighting by itself, and a pair of those.
_WAY = 400.0
_PAIR = 2.0
# Of filters: a part, and a number of a covariance, of all filters together.
_PART = 1500.0
_FILTERED = 0.12
# Of a view that is looked at by itself; and of any that is read where its visit says, and solved
# for in the end.
_VIEW = 2500.0
_READ = 300.0
# Of a likelihood of noise: one of a visit, and a number of its factor's arithmetic.
_LIKELIHOOD = 200.0
_LEARNT = 0.0003


@dataclass(slots=True)
class Budget:
    """`allowed` units of work, and how many are `spent`. Not thread-safe."""

    allowed: float = math.inf
    spent: float = 0.0

    @classmethod
    def of(cls, tracks: Iterable[OdometryTrack], *, share: float = 1.0) -> Self:
        """What a session may take that is as long as its robots' odometry, or a share of it."""
        ends = [(track.first_ns, track.last_ns) for track in tracks if len(track)]
        if not ends:
            return cls(share * _AT_LEAST)
        first, last = min(first for first, _ in ends), max(last for _, last in ends)
        return cls(share * (_AT_LEAST + _A_SECOND * to_seconds(last - first)))

    @property
    def is_spent(self) -> bool:
        return self.spent >= self.allowed

    def spend_reading(self, *, views: int) -> None:
        """Note what grows with the pictures alone: all of them read, and solved for."""
        self.spent += _READ * views

    def spend_looking(self) -> None:
        """Note a view that is looked at by itself."""
        self.spent += _VIEW

    def spend_learning(self, *, unknowns: int) -> None:
        """Note a likelihood of noise by a visit."""
        self.spent += _LIKELIHOOD + _LEARNT * unknowns**3

    def spend_solving(self, *, steps: int, corners: int) -> None:
        """Note a visit's solution in so many steps."""
        self.spent += (steps + _AROUND) * (_STEP + _CORNER * corners)

    def spend_placing(self, *, layouts: int, unknowns: Iterable[int]) -> None:
        """Note hypotheses that are placed, of so many layouts; `unknowns`: of each."""
        self.spent += _LAYOUT * layouts
        self.spent += sum(_PLACED + min(_NUMBER * n**3, _UNKNOWN * n) for n in unknowns)

    def spend_starting(self, *, ways: int, seeds: int) -> None:
        """Note a search for starts among so many ways to read sightings."""
        self.spent += _WAY * ways + _PAIR * ways * seeds

    def spend_filtering(self, *, parts: int, unknowns: int) -> None:
        """Note filters over so many parts."""
        self.spent += parts * (_PART + _FILTERED * unknowns**2)
