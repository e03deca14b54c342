"""What a picture's corners err in together: the robot's sway and tilt."""

import numpy as np
import pytest
from msgspec.structs import replace
from support.fusion.picture_jitter import PictureJitter, base_jacobian
from support.fusion.slow_problem import about_best_fit, picture_of
from support.fusion.small_problems import small_problem

from trigpoint.fusion.model.jitter import Jitter
from trigpoint.fusion.model.prediction import (
    batch_jacobian,
    batch_residual,
    picture_factor,
)
from trigpoint.fusion.model.problem import Batch, Problem, State
from trigpoint.fusion.solver.levenberg_marquardt import linearise
from trigpoint.geometry import Pose

JITTER = Jitter(sway=0.003, tilt=0.02)


def shaken() -> tuple[Problem, Batch, State]:
    """A small problem whose robot sways and tilts in each picture, and its first batch."""
    assembled = small_problem(noise_px=0.5)
    batch = assembled.problem.batches[0]
    shared = replace(batch, jitter=np.tile(JITTER.variances, (len(batch.nodes), 2, 1)))
    return assembled.problem, shared, assembled.start


def swayed(state: State, batch: Batch, by: np.ndarray) -> State:
    """The state with its robot disturbed in each picture (n, 6), each of which has a node."""
    robot = state.robots[batch.robot]
    nodes = [robot.map_from_base[node] for node in range(len(robot.map_from_base))]
    assert len(set(batch.nodes.tolist())) == len(batch.nodes)
    way = Pose.identity().repeated(len(batch.nodes))
    if batch.carried is not None:
        way = batch.carried.at(state.cameras[batch.camera].offset_s(batch.since_epoch_s))
    seen = (robot.map_from_base[batch.nodes] @ way).disturbed(by) @ way.inverse()
    for row, node in enumerate(batch.nodes.tolist()):
        nodes[node] = seen[row]
    moved = replace(robot, map_from_base=Pose.stack(nodes))
    return replace(state, robots=state.robots | {batch.robot: moved})


def test_a_picture_weighs_with_the_inverse_of_its_joint_covariance() -> None:
    problem, batch, state = shaken()
    n, shared = len(batch.nodes), np.diag(JITTER.variances)
    jacobian, residual, _ = batch_jacobian(problem, batch, state)
    by_base = base_jacobian(batch, state)
    jacobian, by = jacobian.reshape(n, -1, jacobian.shape[-1]), by_base.reshape(n, -1, 6)
    residual = residual.reshape(n, -1)
    weight = np.linalg.inv(np.eye(by.shape[1]) + by @ shared @ np.swapaxes(by, 1, 2))
    rows, left = PictureJitter.by(by, np.tile(JITTER.variances, (n, 1))).rows(jacobian, residual)
    turned, pull = np.swapaxes(jacobian, 1, 2) @ weight, residual[..., None]
    np.testing.assert_allclose(
        np.swapaxes(rows, 1, 2) @ rows, turned @ jacobian, rtol=1e-6, atol=1e-3
    )
    np.testing.assert_allclose(
        np.swapaxes(rows, 1, 2) @ left[..., None], turned @ pull, rtol=1e-6, atol=1e-3
    )
    np.testing.assert_allclose(
        np.sum(left**2, axis=1), (np.swapaxes(pull, 1, 2) @ weight @ pull)[:, 0, 0], rtol=1e-9
    )


@pytest.mark.parametrize("is_shared", [False, True])
def test_the_factor_of_a_picture_has_the_squares_of_its_equations(is_shared: bool) -> None:
    problem, batch, state = shaken()
    one = picture_of(batch, 0)
    jitter = PictureJitter.of(one, state)
    jacobian, residual, columns = batch_jacobian(problem, one, state)
    rows, left = jacobian.reshape(1, -1, jacobian.shape[-1]), residual.reshape(1, -1)
    if is_shared and jitter is not None:
        rows, left = jitter.rows(rows, about_best_fit(one, state, jitter)[None])
    else:
        one = replace(one, jitter=None)
    factor, dense = picture_factor(problem, one, state)
    whole = np.concatenate([rows[0], left[0][:, None]], axis=1)
    np.testing.assert_array_equal(dense, columns)
    np.testing.assert_allclose(np.tril(factor, -1), 0.0, atol=1e-9)
    np.testing.assert_allclose(factor.T @ factor, whole.T @ whole, rtol=1e-9, atol=1e-6)


def test_pictures_that_share_a_tilt_weigh_together_as_one() -> None:
    """Of twenty at one place and one far away the mean of the twenty is as good as the one."""
    places = np.array([[0.0, 0.0, 0.0]] * 20 + [[50.0, 0.0, 0.0]])
    jitter = Jitter(sway=0.1, tilt=0.4, length=1.0)
    weights = 1 / jitter.among(places)
    np.testing.assert_allclose(weights[:20, 3:5].sum(axis=0), weights[20, 3:5])
    np.testing.assert_allclose(weights[20], 1 / jitter.variances)
    np.testing.assert_allclose(weights[0, :3], weights[20, :3])  # a mast sways in each anew


def test_pictures_have_the_variances_among_others_and_their_own() -> None:
    places, jitter = np.zeros((20, 3)), Jitter(sway=0.1, tilt=0.4, length=1.0)
    both = jitter.in_pictures(places)
    np.testing.assert_array_equal(both[:, 0], jitter.among(places))
    np.testing.assert_array_equal(both[:, 1], np.tile(jitter.variances, (20, 1)))


def test_variance_of_a_mean_over_a_slope_is_that_by_its_correlation() -> None:
    """Over many lengths the mean of pictures is as good as those weights say."""
    along = np.linspace(0, 40, 2000)
    places = np.stack([along, np.zeros(2000), np.zeros(2000)], axis=1)
    jitter = Jitter(sway=0.1, tilt=0.4, length=0.5)
    true = np.exp(-np.abs(along[:, None] - along) / 0.5).mean() * jitter.tilt**2
    assert np.isclose(1 / (1 / jitter.among(places)[:, 3]).sum(), true, rtol=0.05)


def test_a_tilt_in_each_picture_anew_is_shared_by_none() -> None:
    jitter = Jitter(sway=0.1, tilt=0.4)
    np.testing.assert_allclose(jitter.among(np.zeros((3, 3))), np.tile(jitter.variances, (3, 1)))


def test_a_tilt_of_three_degrees_costs_what_its_prior_says() -> None:
    """Linearised about none it would leave a part of a sigma of each corner."""
    assembled = small_problem(noise_px=0.0)
    batch, state = assembled.problem.batches[0], assembled.start
    variances = Jitter(1e-6, 0.1, 1.0).variances
    n, tilt = len(batch.nodes), np.radians([0, 0, 0, 2.4, -1.8, 0.0])
    seen = batch_residual(batch, swayed(state, batch, np.tile(tilt, (n, 1))))
    seen = seen / np.maximum(batch.weights, 1e-9)[..., None]
    batch = replace(batch, pixels=batch.pixels + seen, jitter=np.tile(variances, (n, 2, 1)))
    cost = linearise(replace(assembled.problem, batches=(batch,)), state).cost
    assert cost == pytest.approx(n * np.sum(tilt**2 / variances), rel=0.05)
