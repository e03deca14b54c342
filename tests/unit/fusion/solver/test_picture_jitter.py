"""What a picture's corners err in together, against the covariance written out."""

import numpy as np
import pytest

from trigpoint.fusion.model.jitter import Jitter
from trigpoint.fusion.solver.picture_jitter import PictureJitter

NODES = np.array([0, 1, 1, 2, 3])
EACH, FLOOR = Jitter(sway=0.1, tilt=0.4), Jitter(sway=0.1, tilt=0.4, is_floor=True)


def drawn(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    return (
        random.normal(size=(5, 12, 6)),
        random.normal(size=(5, 12, 4)),
        random.normal(size=(5, 12)),
    )


def covariance(by_base: np.ndarray, jitter: Jitter) -> np.ndarray:
    """Of all corners (60, 60), by what they share."""
    whole = np.eye(60)
    for one in range(5):
        for other in range(5):
            shared = jitter.variances.copy()
            if one != other:
                shared[:3] = 0
                shared[3:] *= jitter.is_floor and NODES[one] == NODES[other]
            block = by_base[one] @ np.diag(shared) @ by_base[other].T
            whole[12 * one : 12 * one + 12, 12 * other : 12 * other + 12] += block
    return whole


@pytest.mark.parametrize("jitter", [EACH, FLOOR])
def test_elimination_weighs_with_the_inverse_of_the_joint_covariance(jitter: Jitter) -> None:
    by_base, by_others, residual = drawn(1)
    eliminated = PictureJitter.by(by_base, NODES, jitter)
    hessian, gradient, cost = eliminated.eliminated(by_others, residual)
    weight = np.linalg.inv(covariance(by_base, jitter))
    for group, node in enumerate(eliminated.nodes):
        mine = np.repeat((node == NODES) if jitter.is_floor else (np.arange(5) == group), 12)
        own, others = weight[np.ix_(mine, mine)], by_others.reshape(60, 4)[mine]
        np.testing.assert_allclose(hessian[group], others.T @ own @ others)
        np.testing.assert_allclose(gradient[group], others.T @ own @ residual.reshape(60)[mine])
    flat = residual.reshape(-1)
    assert np.isclose(cost, flat @ weight @ flat)


@pytest.mark.parametrize("jitter", [EACH, FLOOR])
def test_determinant_is_that_of_the_joint_covariance(jitter: Jitter) -> None:
    by_base, _, _ = drawn(2)
    expected = np.linalg.slogdet(covariance(by_base, jitter))[1]
    found = PictureJitter.by(by_base, NODES, jitter).log_determinant
    assert np.isclose(found, expected)


def test_a_standing_robot_stands_as_its_floor_does_and_sways_anew() -> None:
    random = np.random.default_rng(3)
    by_base, tilt = 100 * random.normal(size=(2, 40, 6)), random.normal(size=3)
    sway = random.normal(size=(2, 3))
    shift = np.concatenate([sway, np.tile(tilt, (2, 1))], axis=1)
    residual = -(by_base @ shift[..., None])[..., 0]
    wide = Jitter(sway=100.0, tilt=100.0, is_floor=True)
    jitter = PictureJitter.by(by_base, np.array([4, 4]), wide)
    assert np.abs(jitter.compensated(residual)).max() < 1e-2
    # Two tilts that differ are not the floor's.
    residual[1] += by_base[1, :, 3:] @ np.ones(3)
    assert np.abs(jitter.compensated(residual)).max() > 10
