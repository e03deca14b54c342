"""Messages between the live estimator and its solver; all of them can be pickled."""

from collections.abc import Sequence
from typing import Protocol

from msgspec import Struct

from trigpoint.fusion.estimators.results import Results
from trigpoint.fusion.model.dataset import CameraMove, Conclusions, Event
from trigpoint.fusion.model.observations import Observation
from trigpoint.fusion.model.past import Past
from trigpoint.fusion.model.readings import Readings
from trigpoint.fusion.output import Output
from trigpoint.fusion.solver.filter import Filter
from trigpoint.geometry import CameraModel

# -- to the one that solves -----------------------------------------------------------------------


class TakeOdometry(Struct, frozen=True):
    """A robot's odometry messages, as they were taken."""

    robot: str
    readings: Readings


class TakeObservation(Struct, frozen=True):
    """The next observation, and its camera's lens; they are counted. `is_collected`: for the next
    `Finish` alone."""

    observation: Observation
    lens: CameraModel
    is_collected: bool = False


class TakeMove(Struct, frozen=True):
    """A move that a camera noticed itself (`Live.camera_moved`)."""

    move: CameraMove


class LeaveOpen(Struct, frozen=True):
    """Locate none of these cameras (`Live.leave_open`)."""

    cameras: frozenset[str]


class Finish(Struct, frozen=True):
    """Solve to the end, and report."""


class Report(Struct, frozen=True):
    """Report what is known now."""


Order = TakeOdometry | TakeObservation | TakeMove | LeaveOpen | Finish | Report

# -- from the one that solves ---------------------------------------------------------------------

Shares = dict[tuple[str, str], tuple[int, float]]


class Solved(Struct, frozen=True):
    """A solution over the first `count` observations, none of which is stamped later than
    `until_ns`; from the last one corrections go on after a restart.

    `shares`: see `CurrentFilter`; `conclusions`: what happened, and how noisy it was; `located`:
    the cameras that are part of it; `past`: what is not kept any more, where that is more than
    before.
    """

    count: int
    known: Filter
    shares: Shares
    conclusions: Conclusions
    located: tuple[str, ...]
    until_ns: int
    past: Past | None = None


class Reported(Struct, frozen=True):
    """The results as they are known after `orders` orders to report or to finish; `is_final`:
    solved to the end."""

    orders: int
    is_final: bool
    results: Results


News = Solved | Event | Reported | Output
"""An output is sent as it is: where a robot should go next, or how well it is corrected where."""


class Solver(Protocol):
    """A solver that takes orders and has news for the live estimator; used by one thread."""

    def tell(self, orders: Sequence[Order]) -> None:
        """Hand orders over, to be carried out in this order; never waits."""
        ...

    def news(self) -> list[News]:
        """The news since the last call; raise OperationError where none will come any more."""
        ...

    def close(self) -> None:
        """End it, whatever it is doing."""
        ...
