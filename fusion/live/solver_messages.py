"""Messages between the live estimator and its solver; all of them can be pickled."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from trigpoint.contract.messages import OccupancyGrid
from trigpoint.fusion.estimators.results import Results
from trigpoint.fusion.model.dataset import CameraMove, Conclusions, Event
from trigpoint.fusion.model.observations import Observation
from trigpoint.fusion.model.past import Past
from trigpoint.fusion.solver.filter import Filter
from trigpoint.geometry import CameraModel, Pose

# -- to the one that solves -----------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class TakeLens:
    """A camera's lens, before its first observation."""

    camera: str
    lens: CameraModel


@dataclass(frozen=True, slots=True)
class TakeOdometry:
    """A robot's odometry messages, as they were taken: stamps (n,) and poses (n)."""

    robot: str
    stamps_ns: tuple[int, ...]
    odom_from_base: Pose


@dataclass(frozen=True, slots=True)
class TakeObservation:
    """The next observation; they are counted. `is_collected`: for the next `Finish` alone."""

    observation: Observation
    is_collected: bool = False


@dataclass(frozen=True, slots=True)
class TakeMove:
    """A move that a camera noticed itself (`Live.camera_moved`)."""

    move: CameraMove


@dataclass(frozen=True, slots=True)
class LeaveOpen:
    """Locate none of these cameras (`Live.leave_open`)."""

    cameras: frozenset[str]


@dataclass(frozen=True, slots=True)
class Finish:
    """Solve to the end, and report."""


@dataclass(frozen=True, slots=True)
class Report:
    """Report what is known now."""


Order = TakeLens | TakeOdometry | TakeObservation | TakeMove | LeaveOpen | Finish | Report

# -- from the one that solves ---------------------------------------------------------------------

Shares = dict[tuple[str, str], tuple[int, float]]


@dataclass(frozen=True, slots=True)
class Solved:
    """A solution over the first `count` observations.

    `shares`: see `CurrentFilter`; `conclusions`: what happened, and how noisy it was; `located`:
    the cameras that are part of it; `past`: what is not kept any more, where that is more than
    before.
    """

    count: int
    known: Filter
    shares: Shares
    conclusions: Conclusions
    located: tuple[str, ...]
    past: Past | None = None


@dataclass(frozen=True, slots=True)
class Reported:
    """The results as they are known after `orders` orders to report or to finish; `is_final`:
    solved to the end."""

    orders: int
    is_final: bool
    results: Results


@dataclass(frozen=True, slots=True)
class Suggested:
    """Where a robot should go next (`guidance.suggestions`)."""

    robot: str
    stamp_ns: int
    map_from_base: Pose


@dataclass(frozen=True, slots=True)
class Covered:
    """How well a robot is corrected where, where that changed."""

    grid: OccupancyGrid


News = Solved | Event | Reported | Suggested | Covered


@dataclass(frozen=True, slots=True)
class Solution:
    """A solution from which corrections go on after a restart; none of its sightings is stamped
    later than `until_ns`."""

    solved: Solved
    until_ns: int


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
