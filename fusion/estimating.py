"""Which estimator works for a pipeline."""

from collections.abc import Callable

from msgspec import Struct

from .estimators.interface import Live
from .estimators.registry import make_estimator
from .fixed.map import FixedMap
from .fixed.network import FixedNetwork
from .live.follower import Follower
from .live.reports import Immediate, Reports
from .live.solver_messages import Solver
from .model.dataset import DataSet


class Estimating(Struct, frozen=True):
    """An estimator, and where its results come from; `follower`: the estimator that a solver works
    for, None where there is none."""

    estimator: Live
    reports: Reports
    follower: Follower | None = None


def estimating(
    data: DataSet, solver: Solver | None, fixed: FixedNetwork | None, forget: Callable[[], None]
) -> Estimating:
    """A fixed map's, one that a solver works for, or the one that the site file names; `forget`:
    called by an estimator that drops the odometry's past."""
    if fixed is not None:
        held = FixedMap(data, fixed, forget)
        return Estimating(held, held)
    if solver is not None:
        follower = Follower(data, solver, forget)
        return Estimating(follower, follower, follower)
    estimator = make_estimator(data)
    return Estimating(estimator, Immediate(data, estimator))
