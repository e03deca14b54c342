"""What a picture's corners err in together, against the covariance written out."""

from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag
from support.fusion.small_problems import small_problem

from trigpoint.fusion.model.jitter import Jitter
from trigpoint.fusion.model.prediction import base_jacobian, batch_residual
from trigpoint.fusion.solver.picture_jitter import PictureJitter

VARIANCES = np.random.default_rng(0).uniform(0.01, 0.2, (5, 6))


def drawn(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    return (
        random.normal(size=(5, 12, 6)),
        random.normal(size=(5, 12, 4)),
        random.normal(size=(5, 12)),
    )


def covariance(by_base: np.ndarray) -> np.ndarray:
    """Of all corners (60, 60), by what each picture's share."""
    shared = [by @ np.diag(row) @ by.T for by, row in zip(by_base, VARIANCES, strict=True)]
    return np.eye(60) + np.asarray(block_diag(*shared))


def test_elimination_weighs_with_the_inverse_of_the_joint_covariance() -> None:
    by_base, by_others, residual = drawn(1)
    hessian, gradient, cost = PictureJitter.by(by_base, VARIANCES).eliminated(by_others, residual)
    weight = np.linalg.inv(covariance(by_base))
    others, flat = by_others.reshape(60, 4), residual.reshape(60)
    np.testing.assert_allclose(hessian.sum(axis=0), others.T @ weight @ others)
    np.testing.assert_allclose(gradient.sum(axis=0), others.T @ weight @ flat)
    assert np.isclose(cost, flat @ weight @ flat)


def test_determinant_is_that_of_the_joint_covariance() -> None:
    by_base, _, _ = drawn(2)
    expected = np.linalg.slogdet(covariance(by_base))[1]
    assert np.isclose(PictureJitter.by(by_base, VARIANCES).log_determinant, expected)


def test_what_a_disturbance_makes_is_taken_out_and_nothing_else() -> None:
    random = np.random.default_rng(3)
    by_base, shift = 100 * random.normal(size=(2, 40, 6)), random.normal(size=(2, 6))
    jitter = PictureJitter.by(by_base, np.full((2, 6), 1e4))
    residual = -(by_base @ shift[..., None])[..., 0]
    assert np.abs(jitter.compensated(residual)).max() < 1e-2
    residual[1, 0] += 10
    assert np.abs(jitter.compensated(residual)).max() > 5


def test_pictures_that_share_a_tilt_weigh_together_as_one() -> None:
    """Of twenty at one place and one far away the mean of the twenty is as good as the one."""
    places = np.array([[0.0, 0.0, 0.0]] * 20 + [[50.0, 0.0, 0.0]])
    jitter = Jitter(sway=0.1, tilt=0.4, length=1.0)
    weights = 1 / jitter.among(places)
    np.testing.assert_allclose(weights[:20, 3:5].sum(axis=0), weights[20, 3:5])
    np.testing.assert_allclose(weights[20], 1 / jitter.variances)
    np.testing.assert_allclose(weights[0, :3], weights[20, :3])  # a mast sways in each anew


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


def test_a_tilt_of_three_degrees_leaves_nothing_of_its_square() -> None:
    """Linearised about none it leaves a part of a sigma, of one sign in all pictures."""
    assembled = small_problem(noise_px=0.0)
    batch, state = assembled.problem.batches[0], assembled.start
    n = len(batch.nodes)
    tilt = np.tile(np.radians([0, 0, 0, 2.4, -1.8, 0.0]), (n, 1))
    seen = batch_residual(batch, state, tilt) / np.maximum(batch.weights, 1e-9)[..., None]
    batch = replace(batch, pixels=batch.pixels + seen)
    jacobian = base_jacobian(batch, state).reshape(n, -1, 6)
    jitter = PictureJitter.by(jacobian, np.tile(Jitter(1e-6, 0.1, 1.0).variances, (n, 1)))
    residual = batch_residual(batch, state)
    about = jitter.about_fit(batch, state, residual)
    left, square = (
        np.abs(jitter.compensated(each.reshape(n, -1))).max() for each in (about, residual)
    )
    assert square > 0.3
    assert left < square / 20
