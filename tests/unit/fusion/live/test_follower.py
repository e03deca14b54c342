"""Live work where somebody else solves: what comes out, what comes late, and how it ends."""

import os
import signal
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

import numpy as np
import pytest
from builders import eventually
from drives import Session

from trigpoint import cdr, topics
from trigpoint.bus import Publisher
from trigpoint.bus_memory import MemoryBroker
from trigpoint.clock import SystemClock, to_ns
from trigpoint.errors import OperationError
from trigpoint.fusion.checkpoint import Checkpoint
from trigpoint.fusion.estimators.results import Results
from trigpoint.fusion.estimators.smoother.current_filter import CurrentFilter
from trigpoint.fusion.live.follower import catching_up
from trigpoint.fusion.live.solver_messages import News, Order, Report, Reported, Solver
from trigpoint.fusion.live.solver_process import SolverProcess
from trigpoint.fusion.live.solver_worker import SolverWorker
from trigpoint.fusion.model.dataset import Event
from trigpoint.fusion.node import FusionNode
from trigpoint.fusion.pipeline import Inputs, Output, Pipeline
from trigpoint.fusion.solver import gaussian
from trigpoint.messages import CameraInfo, Message, Odometry, PoseEstimate, Sightings
from trigpoint.network import Network, load_network
from trigpoint.node import Node

# What is waited for comes by work alone, of which a busy machine does a twentieth of the usual.
PATIENCE_S = 500.0

Messages = tuple[tuple[str, Message], ...]
TOPIC_OF = {Odometry: topics.ODOMETRY, Sightings: topics.SIGHTINGS, CameraInfo: topics.CAMERA_INFO}


class SlowSolver:
    """Solves in place, but is only done with an order after so many more calls."""

    def __init__(self, inputs: Inputs, *, calls: int = 0) -> None:
        self._worker = SolverWorker(inputs.data_set(), time.perf_counter)
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
        found = []
        while self._found and self._found[0][0] <= self._count:
            found.append(self._found.popleft()[1])
        return found

    def solve(self) -> None:
        """Solve now over what it was told."""
        self._worker._smoother.solve()
        self._found.extend((0, item) for item in self._worker._solved(0.0))

    def close(self) -> None:
        self._orders.clear()


class StuckSolver(SlowSolver):
    """Never says anything any more from some call on."""

    is_stuck = False
    has_reported = False

    def news(self) -> list[News]:
        if self.is_stuck:
            return []
        found = super().news()
        self.has_reported |= any(isinstance(item, Reported) for item in found)
        return found


def driven(pipeline: Pipeline, messages: Messages) -> list[Output]:
    """What a pipeline says while messages come, pictures 20 ms after their moment."""
    sent: list[Output] = []
    for node, message in messages:
        pipeline.push(node, message)
        assert isinstance(message, Odometry | Sightings)
        sent += pipeline.advance(message.stamp_ns + to_ns(0.02))
    return sent


def finished(pipeline: Pipeline) -> Network:
    """The network after everything was solved to the end."""
    pipeline.finish()
    assert eventually(lambda: bool(pipeline.advance()) or pipeline.is_answered, timeout_s=60.0)
    assert eventually(lambda: pipeline.is_answered or bool(pipeline.advance()), timeout_s=60.0)
    assert pipeline.is_final
    return pipeline.results().network


def assert_same_places(network: Network, expected: Network) -> None:
    for name, record in expected.cameras.items():
        mine = network.cameras[name]
        assert (mine.status, mine.sightings) == (record.status, record.sightings)
        assert mine.map_from_camera is not None
        assert record.map_from_camera is not None
        apart = mine.map_from_camera.pose.difference(record.map_from_camera.pose)
        sigma = np.sqrt(np.diagonal(record.covariance_matrix))
        np.testing.assert_allclose(apart / sigma, 0.0, atol=0.1)


def corrected(sent: list[Output]) -> list[int]:
    stamps = []
    for output in sent:
        if output.topic is topics.CORRECTION:
            assert isinstance(output.message, PoseEstimate)
            stamps.append(output.message.stamp_ns)
    return stamps


@pytest.mark.parametrize("calls", [0, 150], ids=["at once", "three seconds later"])
def test_live_with_a_solver_ends_where_batch_ends(
    charuco: Session, charuco_results: Results, calls: int
) -> None:
    solver = SlowSolver(charuco.inputs, calls=calls)
    pipeline = Pipeline(charuco.inputs, solver=solver)
    sent = driven(pipeline, charuco.messages)
    assert len(corrected(sent)) > 10
    assert_same_places(finished(pipeline), charuco_results.network)


def test_corrections_and_robot_poses_with_a_slow_solver_are_honest(charuco: Session) -> None:
    pipeline = Pipeline(charuco.inputs, solver=SlowSolver(charuco.inputs, calls=60))
    squares = []
    for output in driven(pipeline, charuco.messages):
        if output.topic is not topics.CORRECTION:
            continue
        assert isinstance(output.message, PoseEstimate)
        message, plane = output.message, [0, 1, 5]
        error = message.pose.difference(charuco.map_from_base("r1", message.stamp_ns))[plane]
        covariance = message.covariance[np.ix_(plane, plane)]
        squares.append(float(error @ np.linalg.solve(covariance, error)))
    assert len(squares) > 10
    assert max(squares) < 25
    assert 0.3 < np.mean(squares) / 3 < 2.25


def pictures(session: Session, camera: str) -> list[Sightings]:
    return [m for n, m in session.messages if n == camera and isinstance(m, Sightings) and m.faces]


def test_sighting_that_comes_late_right_after_a_swap_makes_a_correction(charuco: Session) -> None:
    shown = pictures(charuco, "c1")
    late, after = shown[9:11]
    solver = SlowSolver(charuco.inputs)
    pipeline = Pipeline(charuco.inputs, solver=solver)
    messages = tuple(item for item in charuco.messages if item[1] is not late)
    until = next(i for i, item in enumerate(messages) if item[1] is after)
    driven(pipeline, messages[: until + 1])
    for _ in range(3):  # solved, taken over, and brought up to now
        solver.solve()
        pipeline.advance()
    pipeline.push("c1", late)
    assert late.stamp_ns in corrected(pipeline.advance(after.stamp_ns + to_ns(0.3)))


def test_late_sighting_is_put_in_its_place_where_much_is_known(
    charuco: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is known of many cameras is worked out anew now and then, between filters that stay."""
    ends = []
    for most_near in (gaussian._MOST_NEAR, 1):
        monkeypatch.setattr(gaussian, "_MOST_NEAR", most_near)
        early, held = Pipeline(charuco.inputs), pictures(charuco, "c1")[9]
        kept = tuple(item for item in charuco.messages if item[1] is not held)
        until = next(i for i, item in enumerate(kept) if item[1] is pictures(charuco, "c1")[15])
        driven(early, kept[:until])
        early.push("c1", held)
        early.advance()
        ends.append(early.robot("r1"))
    assert ends[0] is not None
    assert ends[1] is not None
    np.testing.assert_allclose(ends[0].covariance, ends[1].covariance, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(
        ends[0].map_from_base.difference(ends[1].map_from_base), 0.0, atol=1e-9
    )


def test_much_is_worked_out_in_turns_in_which_no_robot_waits(
    charuco: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    settled_after: list[bool] = []
    settle = CurrentFilter.settle

    def noted(current: CurrentFilter) -> None:
        before = current.known
        settle(current)
        settled_after.append(current.known is not before)

    monkeypatch.setattr(CurrentFilter, "settle", noted)
    # The robot and two of the three cameras are over half of what may be near, all of them less.
    monkeypatch.setattr(gaussian, "_MOST_NEAR", 24)
    solver = SlowSolver(charuco.inputs)
    pipeline = Pipeline(charuco.inputs, solver=solver)
    for node, message in charuco.messages:
        came = len(settled_after)
        pipeline.push(node, message)
        if isinstance(message, Odometry):
            is_corrected = bool(corrected(pipeline.advance(message.stamp_ns)))
            assert not is_corrected or len(settled_after) == came
        if len(settled_after) % 200 == 100:
            solver.solve()
    assert any(settled_after)


@pytest.mark.parametrize("turns", [(1, 0, 0, 0), (2, 0), (5, 0), (1,), (3, 1), (1, 2, 0)])
def test_new_filter_gains_on_what_comes_in_any_pattern(turns: tuple[int, ...]) -> None:
    """And leaves a turn with one sighting after a turn without to the robot that waits."""
    before = (turns[-1], *turns)
    caught_up = [catching_up(came, last) for came, last in zip(turns, before, strict=False)]
    assert sum(caught_up) > sum(turns)
    assert catching_up(1, 0) == 0


# -- in a process of its own, on a bus ------------------------------------------------------------


class Feed(Protocol):
    """Publishes messages, and waits until their odometry has been taken in."""

    def __call__(self, messages: Messages, *, is_awaited: bool = True) -> None: ...


@contextmanager
def running(
    inputs: Inputs, out: Path, make: Callable[[], Solver]
) -> Iterator[tuple[FusionNode, Node, Feed]]:
    """A fusion node with a solver, and what publishes messages to it."""
    broker = MemoryBroker()
    with (
        broker.session() as bus,
        broker.session() as other,
        Node(bus, site="lab", kind="fusion", name="fusion") as node,
    ):
        fusion = FusionNode(bus, node, inputs, out, SystemClock(), solver=make)
        fusion.start()

        def feed(messages: Messages, *, is_awaited: bool = True) -> None:
            publishers: dict[str, Publisher] = {}
            before = node.health.total("received lab/robot/r1/odom")
            for name, message in messages:
                topic = TOPIC_OF[type(message)]  # pyright: ignore[reportArgumentType]
                key = topic.key("lab", name)
                if key not in publishers:
                    publishers[key] = other.publisher(topic, key)
                publishers[key].put(cdr.encode(message))
            count = before + sum(isinstance(m, Odometry) for _, m in messages)
            received = node.health.total
            if is_awaited:
                until(node, lambda: received("received lab/robot/r1/odom") == count)

        try:
            yield fusion, node, feed
        finally:
            node.stop()


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
    monkeypatch.setattr("trigpoint.fusion.node._LAST_SOLUTION_S", PATIENCE_S)

    def make() -> Solver:
        return SolverProcess(charuco.inputs.data_set())

    with running(charuco.inputs, tmp_path, make) as (fusion, node, feed):
        feed(charuco.messages)
        until(node, lambda: node.health.report().values["cameras_located"] == "3")
    fusion.finish()
    assert_same_places(load_network(tmp_path), charuco_results.network)


def test_what_came_before_a_stop_is_taken_in(charuco: Session, tmp_path: Path) -> None:
    odometry = tuple((n, m) for n, m in charuco.messages if isinstance(m, Odometry))[:200]
    with running(charuco.inputs, tmp_path, lambda: SlowSolver(charuco.inputs)) as (_, node, feed):
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
            assert eventually(lambda: bool(solver.news()), timeout_s=20.0)
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
    with running(charuco.inputs, tmp_path, lambda: solver) as (fusion, node, feed):
        half = len(charuco.messages) // 2
        feed(charuco.messages[:half])
        until(node, lambda: solver.has_reported)
        solver.is_stuck = True
        feed(charuco.messages[half : half + 50])
    fusion.finish()
    assert "would take longer than a stop may" in caplog.text
    network = load_network(tmp_path)
    assert network.cameras["c1"].status == "located"


def test_what_comes_while_a_checkpoint_is_read_follows_it(
    charuco: Session, charuco_results: Results, tmp_path: Path
) -> None:
    half = len(charuco.messages) // 2
    checkpoint = Checkpoint(tmp_path / "checkpoint.bin", SystemClock())
    for name, message in charuco.messages[:half]:
        topic = TOPIC_OF[type(message)]
        checkpoint.write(topic.key("lab", name), cdr.encode(message))
    checkpoint.close()
    solver = SlowSolver(charuco.inputs)
    with running(charuco.inputs, tmp_path, lambda: solver) as (fusion, node, feed):
        feed(charuco.messages[half:])
        until(node, lambda: fusion.is_resumed)
    fusion.finish()
    assert_same_places(load_network(tmp_path), charuco_results.network)


def test_stop_while_a_checkpoint_is_read_leaves_everything_as_it_was(
    charuco: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    checkpoint = Checkpoint(tmp_path / "checkpoint.bin", SystemClock())
    for name, message in charuco.messages:
        key = TOPIC_OF[type(message)].key("lab", name)
        checkpoint.write(key, cdr.encode(message))
    checkpoint.close()
    (tmp_path / "network.json").write_text("of before")
    before = (tmp_path / "checkpoint.bin").read_bytes()
    take_again = FusionNode._take_again

    def stopped(self: FusionNode, key: str, payload: bytes) -> int:
        self._node.stop()
        return take_again(self, key, payload)

    monkeypatch.setattr(FusionNode, "_take_again", stopped)
    with running(charuco.inputs, tmp_path, lambda: SlowSolver(charuco.inputs)) as (fusion, node, _):
        until(node, node.stopping.is_set)
    fusion.finish()
    assert not fusion.is_resumed
    assert (tmp_path / "network.json").read_text() == "of before"
    assert (tmp_path / "checkpoint.bin").read_bytes() == before
