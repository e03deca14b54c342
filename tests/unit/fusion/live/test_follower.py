"""Live work where somebody else solves: what comes out, and what comes late."""

import numpy as np
import pytest
from support.builders import eventually
from support.fusion.drives import Session
from support.fusion.networks import assert_same_places
from support.fusion.solvers import SlowSolver

from trigpoint.base.clock import to_ns
from trigpoint.contract import topics
from trigpoint.contract.messages import Message, Odometry, PoseEstimate, Sightings
from trigpoint.fusion.estimators.results import Results
from trigpoint.fusion.estimators.smoother.current_filter import CurrentFilter
from trigpoint.fusion.intake.message_intake import Intake
from trigpoint.fusion.live.follower import catching_up
from trigpoint.fusion.pipeline import Output, Pipeline
from trigpoint.fusion.solver import gaussian
from trigpoint.map.network import Network

# What is waited for comes by work alone, of which a busy machine does a twentieth of the usual.
PATIENCE_S = 500.0

Messages = tuple[tuple[str, Message], ...]


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

    def is_reported() -> bool:
        pipeline.advance()
        return pipeline.reports.is_answered

    assert eventually(is_reported, timeout_s=60.0)
    assert pipeline.reports.is_final
    return pipeline.results().network


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


@pytest.mark.parametrize("is_live", [False, True], ids=["offline", "with a solver"])
def test_camera_whose_last_pictures_are_undecided_is_not_located(
    charuco: Session, charuco_results: Results, monkeypatch: pytest.MonkeyPatch, is_live: bool
) -> None:
    monkeypatch.setattr(Intake, "undecided", frozenset({"c2"}))
    solver = SlowSolver(charuco.inputs, calls=0) if is_live else None
    pipeline = Pipeline(charuco.inputs, solver=solver)
    driven(pipeline, charuco.messages)
    network = finished(pipeline)
    assert network.located == [name for name in charuco_results.network.located if name != "c2"]
    assert "not decided in time" in network.cameras["c2"].undetermined[0]


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
        ends.append(early._estimator.robot("r1"))
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
