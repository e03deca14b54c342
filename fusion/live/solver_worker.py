"""Solves for a live estimator: orders in, news out.

Pure: it runs in a process of its own (`solver_process`) or in place.
"""

from collections.abc import Callable, Iterator

from scipy.linalg import LinAlgError

from trigpoint.fusion.estimators.results import map_id_of, results_of
from trigpoint.fusion.estimators.smoother.smoother import Smoother
from trigpoint.fusion.model.dataset import DataSet, Event
from trigpoint.fusion.solver.snapshot import GuidanceWorld

from .solver_messages import (
    Finish,
    Happened,
    News,
    Order,
    Report,
    Reported,
    Solved,
    TakeLens,
    TakeObservation,
    TakeOdometry,
)


class SolverWorker:
    """A smoother that takes orders. Not thread-safe.

    `seconds`: the processor's or anyone's time, by which solutions are measured.
    """

    def __init__(self, data: DataSet, seconds: Callable[[], float]) -> None:
        self._data, self._seconds = data, seconds
        self._smoother = Smoother(data)
        self._count = 0
        self._orders = 0

    def carry_out(self, order: Order) -> Iterator[News]:
        """Carry out an order; the news from it."""
        began, solutions = self._seconds(), self._smoother.solutions
        if isinstance(order, TakeLens):
            self._data.lenses[order.camera] = order.lens
        elif isinstance(order, TakeOdometry):
            self._smoother.add_odometry(order.robot, order.stamp_ns, order.odom_from_base)
        elif isinstance(order, TakeObservation):
            yield from self._take(order)
        else:
            if isinstance(order, Finish):
                self._smoother.finish()
            self._orders += 1
        is_solved = self._smoother.solutions != solutions
        if is_solved:
            yield from self._solved(self._seconds() - began)
        yield from self._events()
        # Every solution is reported, however much there is to be done still: whoever stops us may
        # not wait for the next one.
        if is_solved or isinstance(order, Finish | Report):
            yield self.report(is_final=isinstance(order, Finish))

    def _take(self, order: TakeObservation) -> Iterator[News]:
        self._count += 1
        if order.is_collected:
            self._smoother.collect(order.observation)
            return
        update = self._smoother.add_observation(order.observation)
        if update.problem:
            yield Happened(Event("unusable", update.problem))

    def _solved(self, took_s: float) -> Iterator[News]:
        known = self._smoother.current.known
        try:
            known = known.settled() if known is not None else None
        except LinAlgError:
            return  # not determined yet: nothing to go on from
        if known is None:
            return
        jumps = {name: track.jump_steps for name, track in self._data.tracks.items()}
        yield Solved(
            self._count,
            known,
            self._smoother.current.shares,
            tuple(self._data.moves),
            jumps,
            tuple(self._smoother.located),
            took_s,
        )

    def _events(self) -> Iterator[News]:
        events, self._data.events = self._data.events, []
        for event in events:
            yield Happened(event)

    def report(self, *, is_final: bool = False) -> Reported:
        """The results as they are known now."""
        results = results_of(self._data, self._smoother, map_id_of(self._data))
        return Reported(self._count, self._orders, is_final, results)

    def guidance_world(self) -> GuidanceWorld | None:
        """See `Smoother`."""
        return self._smoother.guidance_world()
