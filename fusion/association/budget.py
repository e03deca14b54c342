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

# Twice what `calibrate` is meant to take: ten seconds, and a tenth of the session.
_AT_LEAST = 20e6
_A_SECOND = 0.2e6
# As measured. Of a solution: a step, a corner in it, a number of a dense factor's arithmetic.
_STEP = 1500.0
_CORNER = 3.0
_NUMBER = 0.0015
# Of starts: a way to read a sighting by itself, and a pair of those.
_WAY = 1000.0
_PAIR = 6.0
# Of filters: a number of a covariance, of all filters together.
_FILTERED = 0.12


@dataclass(slots=True)
class Budget:
    """`allowed` units of work, and how many are `spent`. Not thread-safe."""

    allowed: float = math.inf
    spent: float = 0.0

    @classmethod
    def of(cls, tracks: Iterable[OdometryTrack]) -> Self:
        """What a session may take that is as long as its robots' odometry."""
        ends = [(track.first_ns, track.last_ns) for track in tracks if len(track)]
        if not ends:
            return cls(_AT_LEAST)
        first, last = min(first for first, _ in ends), max(last for _, last in ends)
        return cls(_AT_LEAST + _A_SECOND * to_seconds(last - first))

    @property
    def is_spent(self) -> bool:
        return self.spent >= self.allowed

    def spend_solving(self, *, steps: int, corners: int = 0, unknowns: int = 0) -> None:
        """Note a solution in so many steps."""
        self.spent += steps * (_STEP + _CORNER * corners + _NUMBER * unknowns**3)

    def spend_starting(self, *, ways: int, seeds: int) -> None:
        """Note a search for starts among so many ways to read sightings."""
        self.spent += _WAY * ways + _PAIR * ways * seeds

    def spend_filtering(self, *, parts: int, unknowns: int) -> None:
        """Note filters over so many parts."""
        self.spent += parts * (_STEP + _FILTERED * unknowns**2)
