"""A robot that stands before a camera for long before it drives: bounded, and the same map."""

import numpy as np
import pytest
from msgspec.structs import replace
from support.fusion.drives import STANDS_S, Session, pushed
from support.fusion.networks import apart_sigmas
from support.fusion.solvers import SlowSolver

from trigpoint.base.clock import to_ns
from trigpoint.contract import topics
from trigpoint.contract.messages import Odometry
from trigpoint.fusion.estimators.results import Results
from trigpoint.fusion.intake import standstills
from trigpoint.fusion.intake.standstills import MOST_ALIKE
from trigpoint.fusion.model.odometry import MOST_STANDING
from trigpoint.fusion.pipeline import Pipeline
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import about_z

PICTURES = 120  # of the standstill, before c1 alone


def sigmas_of(results: Results) -> np.ndarray:
    """The sigmas of each camera's pose, (n, 6)."""
    cameras = results.network.cameras.values()
    return np.sqrt([np.diagonal(camera.covariance_matrix) for camera in cameras])


def apart(results: Results, other: Results) -> np.ndarray:
    """By how many of the other's sigmas cameras differ, (n, 6)."""
    pairs = zip(results.network.cameras.values(), other.network.cameras.values(), strict=True)
    return np.array([apart_sigmas(mine, theirs) for mine, theirs in pairs])


def test_map_of_what_is_kept_is_that_of_everything(
    standing: Session, standing_bounded: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(standstills, "MOST_ALIKE", 10**6)
    everything = pushed(standing.inputs, standing.messages)
    assert standing_bounded.left_out["standing_still"] == PICTURES - MOST_ALIKE
    assert "standing_still" not in everything.left_out
    some, all_ = standing_bounded.results(), everything.results()
    sigmas, least = sigmas_of(some), sigmas_of(all_)
    # The simulated pictures' errors are independent: no real ones gain as much by more of them.
    assert np.all(sigmas >= 0.99 * least)
    assert np.all(sigmas <= np.sqrt(PICTURES / MOST_ALIKE) * least)
    # What some of the data says differs from what all of it says by no more than its own sigma.
    assert np.abs(apart(all_, some)).max() < 3.0


def test_odometry_that_wanders_at_rest_is_as_bounded(
    standing: Session, standing_bounded: Pipeline
) -> None:
    """A gyroscope's heading wanders by 0.005°/√s and creeps by 0.01°/s."""
    draw, creep, last_ns = np.random.default_rng(1), 0.0, 0
    messages = []
    for node, message in standing.messages:
        if isinstance(message, Odometry):
            seconds = min((message.stamp_ns - last_ns) / 1e9, 1.0) if last_ns else 0.0
            last_ns = message.stamp_ns
            wander = 0.005 * np.sqrt(seconds) * draw.normal()
            creep += np.radians(0.01 * seconds + wander)
            turn = Pose(about_z(creep), np.zeros(3))
            message = replace(message, pose=turn @ message.pose)
        messages.append((node, message))
    wandering = pushed(standing.inputs, tuple(messages))
    # It takes some pictures until its rest is known.
    assert wandering.left_out["standing_still"] >= PICTURES - MOST_ALIKE - 4
    exact, noisy = standing_bounded.results(), wandering.results()
    assert np.all(sigmas_of(noisy) > 0.9 * sigmas_of(exact))
    assert np.abs(apart(noisy, exact)).max() < 3.0


def test_live_a_standstill_is_bounded_and_ends_where_batch_ends(
    standing: Session, standing_bounded: Pipeline
) -> None:
    solver = SlowSolver(standing.inputs)
    pipeline = Pipeline(standing.inputs, solver=solver)
    corrected: list = []
    known = []
    drives_ns = standing.messages[0][1].stamp_ns + to_ns(STANDS_S)
    for node, message in standing.messages:
        pipeline.push(node, message)
        sent = pipeline.advance(message.stamp_ns + to_ns(0.02))
        corrected += [output.message for output in sent if output.topic is topics.CORRECTION]
        if isinstance(message, Odometry) and message.stamp_ns in (
            drives_ns - to_ns(15.0),
            drives_ns,
        ):
            known.append(np.diagonal(pipeline._estimator.cameras()["c1"].covariance))
            assert len(solver.data.entries) <= MOST_ALIKE
            assert len(solver.data.tracks["r1"]) < MOST_STANDING + 50
    pipeline.finish()
    pipeline.advance()
    assert pipeline.reports.is_answered
    # It stands where the map begins, which nothing measures; then it is corrected.
    assert not [m for m in corrected if m.stamp_ns < drives_ns]
    assert corrected
    assert pipeline.left_out["standing_still"] == PICTURES - MOST_ALIKE
    live, batch = pipeline.results(), standing_bounded.results()
    assert np.abs(apart(live, batch)).max() < 0.1
    # Of what repeats nothing is learnt.
    np.testing.assert_allclose(known[1], known[0], rtol=0.05)
