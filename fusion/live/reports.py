"""A session's results: there at any moment, or as a solver last reported them."""

from typing import Protocol

from trigpoint.fusion.estimators.interface import Estimator
from trigpoint.fusion.estimators.results import Results, map_id_of, results_of
from trigpoint.fusion.model.dataset import DataSet

from .solver_messages import Solution


class Reports(Protocol):
    """The results as they are known now."""

    def ask(self) -> None:
        """Request a report of what is known now; `is_answered` says when it is there."""
        ...

    @property
    def is_answered(self) -> bool:
        """Whether everything that was asked for has been reported, the end of the session too."""
        ...

    @property
    def solution(self) -> Solution | None:
        """The last solution, from which a later process goes on; None where there is no solver."""
        ...

    @property
    def is_final(self) -> bool:
        """Whether the results are those of everything, solved to the end."""
        ...

    @property
    def has_results(self) -> bool:
        """Whether there are any."""
        ...

    def results(self) -> Results:
        """The network with covariance and trajectories; raise OperationError where there are no
        results yet."""
        ...


class Immediate:
    """The reports of an estimator that solves within its turn: available at any moment."""

    def __init__(self, data: DataSet, estimator: Estimator) -> None:
        self._data, self._estimator = data, estimator
        self.is_answered = self.is_final = self.has_results = True
        self.solution = None

    def ask(self) -> None:
        """Nothing needs to be requested."""

    def results(self) -> Results:
        return results_of(self._data, self._estimator, map_id_of(self._data))
