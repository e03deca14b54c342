"""Solves for a live estimator: orders in, news out.

Pure: it runs in a process of its own (`solver_process`) or in place.
"""

from collections.abc import Iterator

from numpy.linalg import LinAlgError

from trigpoint.fusion.estimators.results import results_of
from trigpoint.fusion.estimators.smoother.settled_past import LIVE, Limits
from trigpoint.fusion.estimators.smoother.smoother import Smoother
from trigpoint.fusion.model.dataset import DataSet, Event
from trigpoint.fusion.solver.snapshot import GuidanceWorld

from .solver_messages import (
    Finish,
    LeaveOpen,
    News,
    Order,
    Reported,
    Solved,
    TakeMove,
    TakeObservation,
    TakeOdometry,
)


class SolverWorker:
    """A smoother that takes orders. Not thread-safe. `limits`: on what it keeps."""

    def __init__(self, data: DataSet, limits: Limits = LIVE) -> None:
        self._data, self._smoother = data, Smoother(data, limits)
        self._count, self._until_ns = 0, 0
        self._is_collecting = False  # so that everything is solved once, at `Finish`
        self._orders = 0
        self._told, self._solutions = data.past, 0

    def carry_out(self, order: Order) -> Iterator[News]:
        """Carry out an order; yields the news from it."""
        if isinstance(order, TakeOdometry):
            self._smoother.add_odometry(order.robot, order.readings)
        elif isinstance(order, TakeObservation):
            yield from self._take(order)
        elif isinstance(order, TakeMove):
            self._smoother.camera_moved(order.move)
        elif isinstance(order, LeaveOpen):
            self._smoother.leave_open(order.cameras)
        else:
            self._orders += 1
            if isinstance(order, Finish):
                self._is_collecting = False
                yield from self._solve()
            yield self.report(is_final=isinstance(order, Finish))

    def rest(self) -> Iterator[News]:
        """Explain what came, where that is due; called when no order waits. Yields the news."""
        if self._smoother.is_due and not self._is_collecting:
            yield from self._solve()
            yield self.report()

    def _take(self, order: TakeObservation) -> Iterator[News]:
        self._count += 1
        self._until_ns = max(self._until_ns, order.observation.stamp_ns)
        self._data.lenses.setdefault(order.observation.camera, order.lens)
        self._is_collecting |= order.is_collected
        if order.is_collected:
            self._smoother.collect(order.observation)
            return
        update = self._smoother.take(order.observation)
        if update.problem:
            yield Event("unusable", update.problem)

    def _solve(self) -> Iterator[News]:
        self._smoother.finish()
        events, self._data.events = self._data.events, []
        yield from events
        known = self._smoother.current.known
        if known is None or self._smoother.solutions == self._solutions:
            return
        self._solutions = self._smoother.solutions
        try:
            known = known.settled()
        except LinAlgError:
            return  # not determined yet: nothing to go on from
        past = self._data.past
        yield Solved(
            self._count,
            known,
            dict(self._smoother.current.shares),
            self._data.conclusions(),
            tuple(self._smoother.located),
            self._until_ns,
            None if past is self._told else past,
        )
        self._told = past

    def report(self, *, is_final: bool = False) -> Reported:
        """The results as they are known now."""
        return Reported(self._orders, is_final, results_of(self._data, self._smoother))

    def guidance_world(self) -> GuidanceWorld | None:
        """See `Smoother`."""
        return self._smoother.guidance_world()
