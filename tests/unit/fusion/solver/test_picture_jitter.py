"""What a picture's corners err in together, against the covariance written out."""

import numpy as np

from trigpoint.fusion.solver.picture_jitter import Jitter

VARIANCES = np.array([1e-2, 2e-2, 3e-2, 1e-1, 2e-1, 3e-1])
NODES = np.array([0, 1, 1, 2, 3])


def drawn(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    return (
        random.normal(size=(5, 12, 6)),
        random.normal(size=(5, 12, 4)),
        random.normal(size=(5, 12)),
    )


def test_elimination_weighs_with_the_inverse_of_the_joint_covariance() -> None:
    by_base, by_others, residual = drawn(1)
    jitter = Jitter.from_jacobian(by_base, NODES, VARIANCES)
    hessian, gradient, cost = jitter.eliminated(by_others, residual)
    expected = 0.0
    for group, node in enumerate(np.unique(NODES)):
        mine = node == NODES
        shared, others = by_base[mine].reshape(-1, 6), by_others[mine].reshape(-1, 4)
        left = residual[mine].reshape(-1)
        weight = np.linalg.inv(np.eye(len(left)) + shared @ np.diag(VARIANCES) @ shared.T)
        np.testing.assert_allclose(hessian[group], others.T @ weight @ others)
        np.testing.assert_allclose(gradient[group], others.T @ weight @ left)
        expected += float(left @ weight @ left)
    assert np.isclose(cost, expected)


def test_determinant_is_that_of_the_joint_covariance() -> None:
    by_base, _, _ = drawn(2)
    jitter = Jitter.from_jacobian(by_base, NODES, VARIANCES)
    expected = 0.0
    for node in np.unique(NODES):
        shared = by_base[node == NODES].reshape(-1, 6)
        whole = np.eye(len(shared)) + shared @ np.diag(VARIANCES) @ shared.T
        expected += float(np.linalg.slogdet(whole)[1])
    assert np.isclose(jitter.log_determinant, expected)


def test_pictures_at_one_node_share_their_disturbance() -> None:
    random = np.random.default_rng(3)
    by_base, true = 100 * random.normal(size=(2, 40, 6)), random.normal(size=6)
    residual = -(by_base @ true)
    jitter = Jitter.from_jacobian(by_base, np.array([4, 4]), np.full(6, 1e4))
    np.testing.assert_allclose(jitter.expected(residual), true[None], rtol=1e-4)
    assert np.abs(jitter.compensated(residual)).max() < 1e-2
