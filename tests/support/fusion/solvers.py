"""Solvers that work in the test's own process."""

from collections import deque
from collections.abc import Sequence

from trigpoint.fusion.estimators.smoother.settled_past import LIVE, Limits
from trigpoint.fusion.estimators.smoother.smoother import Smoother
from trigpoint.fusion.live.solver_messages import News, Order, Reported
from trigpoint.fusion.live.solver_worker import SolverWorker
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.pipeline import Inputs


class SlowSolver:
    """Solves in place, but is only done with an order after so many more calls."""

    def __init__(self, inputs: Inputs, *, calls: int = 0, limits: Limits = LIVE) -> None:
        self.data = inputs.data_set()
        self._worker = SolverWorker(self.data, limits)
        self._orders: deque[Order] = deque()
        self._found: deque[tuple[int, News]] = deque()
        self._calls, self._count = calls, 0

    def tell(self, orders: Sequence[Order]) -> None:
        self._orders.extend(orders)

    def news(self) -> list[News]:
        self._count += 1
        while self._orders:
            for item in self._worker.carry_out(self._orders.popleft()):
                self._found.append((self._count + self._calls, item))
        for item in self._worker.rest():
            self._found.append((self._count + self._calls, item))
        found = []
        while self._found and self._found[0][0] <= self._count:
            found.append(self._found.popleft()[1])
        return found

    def solve(self) -> None:
        """Solve now over what it was told."""
        self._found.extend((0, item) for item in self._worker._solve())

    def close(self) -> None:
        self._orders.clear()


class FrugalSmoother(Smoother):
    """Keeps little of a session."""

    def __init__(self, data: DataSet) -> None:
        super().__init__(data, Limits(40, paths=True))


class StuckSolver(SlowSolver):
    """Falls silent once it `is_stuck`."""

    is_stuck = False
    has_reported = False

    def news(self) -> list[News]:
        if self.is_stuck:
            return []
        found = super().news()
        self.has_reported |= any(isinstance(item, Reported) for item in found)
        return found


class Listed:
    """A solver that only notes what it is told."""

    def __init__(self) -> None:
        self.orders: list[Order] = []

    def tell(self, orders: Sequence[Order]) -> None:
        self.orders += orders

    def news(self) -> list[News]:
        return []

    def close(self) -> None:
        """Nothing is held open."""
