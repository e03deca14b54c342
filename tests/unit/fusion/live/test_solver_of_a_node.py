"""A fusion node and its solver, on a bus: what it takes over, and how it ends."""

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Protocol

import numpy as np
import pytest
from support.builders import eventually
from support.fusion.drives import EPOCH_NS, Session
from support.fusion.networks import apart_sigmas, assert_same_places
from support.fusion.running_node import Messages, running
from support.fusion.solvers import SlowSolver, StuckSolver

from trigpoint.base.clock import Clock, SystemClock
from trigpoint.base.errors import OperationError
from trigpoint.contract import cdr
from trigpoint.contract.messages import Odometry
from trigpoint.fusion.checkpoint import PAST, Checkpoint
from trigpoint.fusion.estimators.results import Results
from trigpoint.fusion.estimators.smoother.settled_past import Limits
from trigpoint.fusion.inbox import INPUT_TOPICS
from trigpoint.fusion.live.solver_messages import News, Report, Reported, Solver
from trigpoint.fusion.live.solver_process import SolverProcess
from trigpoint.fusion.map_storage import Stored
from trigpoint.fusion.model.dataset import Event
from trigpoint.fusion.node import FusionNode
from trigpoint.fusion.pipeline import Inputs
from trigpoint.fusion.replaying import Replay
from trigpoint.map.network import load_network
from trigpoint.node.node import Node

# What is waited for comes by work alone, of which a busy machine does a twentieth of the usual.
PATIENCE_S = 500.0


class Feed(Protocol):
    """Publishes messages, and waits until their odometry has been taken in."""

    def __call__(self, messages: Messages, *, is_awaited: bool = True) -> None: ...


@contextmanager
def working(
    inputs: Inputs, out: Path, make: Callable[[Inputs], Solver], clock: Clock | None = None
) -> Iterator[tuple[FusionNode, Node, Feed]]:
    """A fusion node with a solver, and what publishes messages to it."""
    with running(inputs, out, clock=clock or SystemClock(), solver=make) as run:

        def feed(messages: Messages, *, is_awaited: bool = True) -> None:
            received = partial(run.node.health.total, "received lab/robot/r1/odom")
            count = received() + sum(isinstance(m, Odometry) for _, m in messages)
            run.put(messages)
            if is_awaited:
                until(run.node, lambda: received() == count)

        try:
            yield run.fusion, run.node, feed
        finally:
            run.node.stop()


def until(node: Node, holds: Callable[[], bool]) -> None:
    """Wait for what work brings about, or for an error that ends the node, which raises it then."""
    assert eventually(lambda: node.stopping.is_set() or holds(), timeout_s=PATIENCE_S)


@pytest.mark.timeout(PATIENCE_S)
def test_process_solves_and_a_stop_has_its_last_solution(
    charuco: Session,
    charuco_results: Results,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # A stop's 1.2 s are enough for it, but not on a machine that does twenty things.
    monkeypatch.setattr("trigpoint.fusion.last_solution._LAST_SOLUTION_S", PATIENCE_S)

    def make(inputs: Inputs) -> Solver:
        return SolverProcess(charuco.inputs.data_set())

    with working(charuco.inputs, tmp_path, make) as (fusion, node, feed):
        feed(charuco.messages)
        until(node, lambda: node.health.report().values["cameras_located"] == "3")
    fusion.finish()
    assert_same_places(load_network(tmp_path), charuco_results.network)


class LongQuarter(SystemClock):
    """Its durations are a tenth of what they are: a stop's quarter of a second lasts, however busy
    the machine is."""

    def elapsed_ns(self) -> int:
        return super().elapsed_ns() // 10


def test_what_came_before_a_stop_is_taken_in(charuco: Session, tmp_path: Path) -> None:
    odometry = tuple((n, m) for n, m in charuco.messages if isinstance(m, Odometry))[:200]
    inputs = charuco.inputs
    with working(inputs, tmp_path, SlowSolver, LongQuarter()) as (_, node, feed):
        feed(odometry[:100])
        feed(odometry[100:], is_awaited=False)
        node.stop()
    assert node.health.total("received lab/robot/r1/odom") == len(odometry)


@pytest.mark.parametrize("megabytes", [0, 2], ids=["small", "large"])
def test_process_that_died_ends_the_node_with_what_to_do(charuco: Session, megabytes: int) -> None:
    """Also one that was killed before it had read what it starts from."""
    data = charuco.inputs.data_set()
    data.events = [Event("ballast", "x" * (megabytes * 2**20))]
    solver = SolverProcess(data)
    os.kill(solver.pid, 9)
    try:
        with pytest.raises(OperationError, match="start fusion again"):
            assert eventually(lambda: bool(solver.news()))
    finally:
        solver.close()


def test_signals_that_stop_the_node_leave_its_solver_at_work(charuco: Session) -> None:
    """Also as it starts: Ctrl-C in a terminal goes to every process."""
    solver = SolverProcess(charuco.inputs.data_set())
    try:
        for number in (signal.SIGINT, signal.SIGTERM):
            os.kill(solver.pid, number)
        solver.tell([Report()])
        (reported,) = news_of(solver)
        os.kill(solver.pid, signal.SIGINT)
        solver.tell([Report()])
        assert isinstance(reported, Reported)
        assert news_of(solver)
    finally:
        solver.close()


def news_of(solver: SolverProcess) -> list[News]:
    found: list[News] = []
    assert eventually(lambda: bool(found.extend(solver.news()) or found), timeout_s=60.0)
    return found


def test_stop_while_a_solution_is_under_way_keeps_what_was_known(
    charuco: Session, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Also where the solver never had a moment without orders."""
    solver = StuckSolver(charuco.inputs)
    with working(charuco.inputs, tmp_path, lambda _: solver) as (fusion, node, feed):
        half = len(charuco.messages) // 2
        feed(charuco.messages[:half])
        until(node, lambda: solver.has_reported)
        solver.is_stuck = True
        feed(charuco.messages[half : half + 50])
    fusion.finish()
    assert "would take longer than a stop may" in caplog.text
    network = load_network(tmp_path)
    assert network.cameras["c1"].status == "located"


def test_stop_before_the_solver_ever_answered_keeps_nothing_and_says_so(
    charuco: Session, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    solver = StuckSolver(charuco.inputs)
    solver.is_stuck = True
    with working(charuco.inputs, tmp_path, lambda _: solver) as (fusion, _node, feed):
        feed(charuco.messages[:50])
    fusion.finish()
    (said,) = (r.getMessage() for r in caplog.records if "longer than a stop" in r.getMessage())
    assert "no network is written" in said
    assert "kept" not in said
    assert not (tmp_path / "network.json").exists()


def test_what_comes_while_a_checkpoint_is_read_follows_it(
    charuco: Session, charuco_results: Results, tmp_path: Path
) -> None:
    half = len(charuco.messages) // 2
    checkpoint = Checkpoint(tmp_path / "checkpoint.bin", SystemClock())
    for name, message in charuco.messages[:half]:
        topic = INPUT_TOPICS[type(message)]
        checkpoint.write(topic.key("lab", name), cdr.encode(message))
    checkpoint.close()
    solver = SlowSolver(charuco.inputs)
    with working(charuco.inputs, tmp_path, lambda _: solver) as (fusion, node, feed):
        feed(charuco.messages[half:])
        until(node, lambda: fusion.is_resumed)
    fusion.finish()
    assert_same_places(load_network(tmp_path), charuco_results.network)


def test_killed_node_goes_on_from_its_last_solution(charuco: Session, tmp_path: Path) -> None:
    with working(charuco.inputs, tmp_path, SlowSolver) as (killed, node, feed):
        feed(charuco.messages)
        until(node, lambda: killed._pipeline.located_count == 3)
        until(node, lambda: killed._solution._kept is killed._pipeline.reports.solution)

    def never(inputs: Inputs) -> Solver:
        return SlowSolver(inputs, calls=10**9)

    with working(charuco.inputs, tmp_path, never) as (fusion, node, _):
        until(node, lambda: fusion.is_resumed and fusion._pipeline.located_count == 3)
        assert not fusion._pipeline.reports.has_results


def test_stop_while_a_checkpoint_is_read_leaves_everything_as_it_was(
    charuco: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    checkpoint = Checkpoint(tmp_path / "checkpoint.bin", SystemClock())
    for name, message in charuco.messages:
        key = INPUT_TOPICS[type(message)].key("lab", name)
        checkpoint.write(key, cdr.encode(message))
    checkpoint.close()
    (tmp_path / "network.json").write_text("of before")
    before = (tmp_path / "checkpoint.bin").read_bytes()
    take_again = FusionNode._take_again

    def stopped(self: FusionNode, replay: Replay, key: str, stored: Stored) -> int:
        self._node.stop()
        return take_again(self, replay, key, stored)

    monkeypatch.setattr(FusionNode, "_take_again", stopped)
    monkeypatch.setattr("trigpoint.fusion.node._READ_AT_ONCE", len(charuco.messages) // 3)
    with working(charuco.inputs, tmp_path, SlowSolver) as (fusion, node, _):
        until(node, node.stopping.is_set)
    fusion.finish()
    assert not fusion.is_resumed
    assert (tmp_path / "network.json").read_text() == "of before"
    assert (tmp_path / "checkpoint.bin").read_bytes() == before


@pytest.mark.timeout(PATIENCE_S)
def test_a_fusion_that_forgot_its_past_goes_on_from_its_summary(
    charuco: Session, charuco_results: Results, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("trigpoint.fusion.last_solution._LAST_SOLUTION_S", PATIENCE_S)
    frugal = partial(SlowSolver, limits=Limits(20))
    stop = next(i for i, m in enumerate(charuco.messages) if m[1].stamp_ns > EPOCH_NS + 20 * 10**9)
    with working(charuco.inputs, tmp_path, frugal) as (fusion, node, feed):
        feed(charuco.messages[:stop])
        until(node, (tmp_path / PAST).exists)
    fusion.finish()
    with working(charuco.inputs, tmp_path, frugal) as (fusion, node, feed):
        until(node, lambda: fusion.is_resumed)
        feed(charuco.messages[stop:])
    fusion.finish()
    network = load_network(tmp_path)
    assert network.map_id == charuco_results.network.map_id
    for name, record in charuco_results.network.cameras.items():
        assert network.cameras[name].sightings == record.sightings
        np.testing.assert_allclose(apart_sigmas(network.cameras[name], record), 0.0, atol=0.25)
