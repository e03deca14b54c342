"""Which estimator works for a pipeline, and where its results come from."""

from collections.abc import Callable

from .estimators.interface import Live
from .estimators.registry import make_estimator
from .estimators.results import Results, results_of
from .fixed.map import FixedMap
from .fixed.network import FixedNetwork
from .live.follower import Follower
from .live.solver_messages import Solver
from .model.dataset import DataSet


class Immediate:
    """The results where no solver reports them (`Follower`): there at any moment."""

    is_answered = is_final = has_results = True
    solution = None

    def __init__(self, results: Callable[[], Results]) -> None:
        self.results = results

    def ask(self) -> None:
        """Nothing needs to be requested."""


Reports = Immediate | Follower


def estimating(
    data: DataSet, solver: Solver | None, fixed: FixedNetwork | None, forget: Callable[[], None]
) -> tuple[Live, Reports]:
    """A fixed map's estimator, one that a solver works for, or the one that the site file names,
    with its results; `forget`: called by an estimator that drops the odometry's past."""
    if fixed is not None:
        return FixedMap(data, fixed, forget), Immediate(lambda: fixed.results)
    if solver is not None:
        follower = Follower(data, solver, forget)
        return follower, follower
    estimator = make_estimator(data)
    return estimator, Immediate(lambda: results_of(data, estimator))
