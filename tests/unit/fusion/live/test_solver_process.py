"""The solver's process: its signs of life, and what it does with orders that pile up."""

from itertools import pairwise

import numpy as np
from support.builders import eventually
from support.fusion.drives import Session
from support.fusion.solvers import Listed

from trigpoint.fusion.estimators.results import Results
from trigpoint.fusion.live.solver_messages import (
    Finish,
    News,
    Order,
    Report,
    Reported,
    Solved,
    TakeObservation,
)
from trigpoint.fusion.live.solver_process import Alive, Heartbeat, SolverProcess
from trigpoint.fusion.live.solver_worker import SolverWorker
from trigpoint.fusion.pipeline import Pipeline
from trigpoint.fusion.replaying import replayed


class Desk:
    """A clock that is set by hand, and what was said."""

    def __init__(self) -> None:
        self.now_s, self.said = 100.0, list[Alive]()
        self.sign = Heartbeat(self.said.append, lambda: self.now_s)

    def give_after(self, seconds: float) -> None:
        self.now_s += seconds
        self.sign.give()


def test_sign_is_given_once_a_second_at_most() -> None:
    desk = Desk()
    for _ in range(9):
        desk.give_after(0.25)
    assert len(desk.said) == 3


def test_what_may_be_waited_for_grows_with_what_a_solution_took() -> None:
    desk = Desk()
    desk.give_after(1.0)
    desk.give_after(90.0)
    desk.give_after(1.0)
    usual, grown, after = (sign.within_s for sign in desk.said)
    assert (grown, after) == (900.0, 900.0)
    assert 60.0 < usual < grown


# -- orders that pile up --------------------------------------------------------------------------


def orders_of(session: Session) -> list[Order]:
    """What a solver is told over a session; the last is to finish."""
    listed = Listed()
    replayed(Pipeline(session.inputs, solver=listed), session.messages).finish()
    return listed.orders


def test_every_solution_is_reported_as_it_is_made(charuco: Session) -> None:
    orders = orders_of(charuco)[:-1]
    took_s: list[float] = []
    solver = SolverProcess(charuco.inputs.data_set(), took=took_s.append)
    found: list[News] = []

    def reports() -> list[Reported]:
        found.extend(solver.news())
        return [item for item in found if isinstance(item, Reported)]

    try:
        # Each time twice as much.
        ends = [0, *(len(orders) // share for share in (4, 2, 1))]
        for count, (start, end) in enumerate(pairwise(ends), start=1):
            solver.tell(orders[start:end])
            assert eventually(lambda count=count: len(reports()) >= count, timeout_s=60.0)
        solver.tell([Report()])
        assert eventually(lambda: bool(reports() and reports()[-1].orders), timeout_s=60.0)
    finally:
        solver.close()
    assert len(took_s) == sum(isinstance(item, Solved) for item in found)
    assert min(took_s) > 0.001
    for report in [item for item in found if isinstance(item, Reported)][:-1]:
        assert report.results.network.located
        assert not report.is_final


def test_what_waits_is_explained_together(charuco: Session) -> None:
    """A solution in between would only delay the next."""
    worker = SolverWorker(charuco.inputs.data_set())
    for order in orders_of(charuco)[:-1]:
        assert not [item for item in worker.carry_out(order) if isinstance(item, Solved)]
    solved, _ = [item for item in worker.rest() if isinstance(item, Solved | Reported)]
    assert isinstance(solved, Solved)
    assert solved.count == sum(isinstance(o, TakeObservation) for o in orders_of(charuco))
    assert not list(worker.rest())
    # Nothing came since: a stop need not wait for the same solution once more.
    (report,) = worker.carry_out(Finish())
    assert isinstance(report, Reported)
    assert report.is_final


def test_session_whose_end_is_left_to_the_finish_ends_where_batch_ends(
    charuco: Session, charuco_results: Results
) -> None:
    orders, worker = orders_of(charuco), SolverWorker(charuco.inputs.data_set())
    half = len(orders) // 2
    for order in orders[:half]:
        list(worker.carry_out(order))
    list(worker.rest())
    news = [item for order in orders[half:] for item in worker.carry_out(order)]
    (report,) = [item for item in news if isinstance(item, Reported)]
    assert report.is_final
    for name, record in charuco_results.network.cameras.items():
        mine = report.results.network.cameras[name]
        assert mine.map_from_camera is not None
        assert record.map_from_camera is not None
        apart = mine.map_from_camera.pose.difference(record.map_from_camera.pose)
        sigma = np.sqrt(np.diagonal(record.covariance_matrix))
        np.testing.assert_allclose(apart / sigma, 0.0, atol=0.1)
