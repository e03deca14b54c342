"""A sighting as a measurement of camera_from_base."""

from collections.abc import Callable

import numpy as np
from support.fusion.small_problems import EPOCH_NS, eyes, see, small_data, true_pose

from trigpoint.base.clock import to_ns
from trigpoint.fusion.estimators.filters.relative_pose import relative_view
from trigpoint.fusion.model.observations import base_from_faces, points_of
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array


def test_robot_that_sways_in_a_picture_is_known_that_much_less_and_seen_where_it_was() -> None:
    """The covariance of a sum is the sum of the covariances, each in the camera's axes."""
    data, stamp_ns = small_data(), EPOCH_NS + to_ns(1.3)
    observation = see(data, "c1", "r1", stamp_ns, 0.3, np.random.default_rng(1))
    camera_from_base = eyes()["c1"].inverse() @ true_pose(data, "r1", stamp_ns)
    sighting = observation, data.targets["r1"], data.lenses["c1"], camera_from_base
    variances = np.array([4e-6, 1e-6, 9e-6, 3e-5, 2e-5, 1e-12])
    still, swaying = relative_view(*sighting), relative_view(*sighting, variances)
    assert still is not None
    assert swaying is not None
    turn = np.kron(np.eye(2), camera_from_base.rotation)
    by_corners = np.linalg.inv(still.root.T @ still.root)
    together = np.linalg.inv(swaying.root.T @ swaying.root)
    assert np.allclose(together, by_corners + turn @ np.diag(variances) @ turn.T, rtol=1e-6)
    step = np.linalg.solve(still.root, still.residual)
    assert np.allclose(np.linalg.solve(swaying.root, swaying.residual), step, atol=1e-9)
    assert np.isclose(swaying.left_over, still.left_over)
    assert swaying.freedom == still.freedom


def test_corners_of_a_robot_that_sways_weigh_with_the_inverse_of_their_joint_covariance() -> None:
    """That covariance is I + J Σ Jᵀ, J the corners' derivative by the robot's deviation."""
    data, stamp_ns = small_data(), EPOCH_NS + to_ns(1.3)
    observation = see(data, "c1", "r1", stamp_ns, 0.3, np.random.default_rng(1))
    camera_from_base = eyes()["c1"].inverse() @ true_pose(data, "r1", stamp_ns)
    target, lens = data.targets["r1"], data.lenses["c1"]
    variances = np.array([4e-6, 1e-6, 9e-6, 3e-5, 2e-5, 1e-6])
    view = relative_view(observation, target, lens, camera_from_base, variances)
    assert view is not None
    points = points_of(observation, target)
    in_base = points.in_base(base_from_faces(target))

    def residual(pose: Pose) -> Array:
        apart = lens.project(pose @ in_base) - points.pixels
        return (apart * points.weights[:, None]).reshape(-1)

    def by(disturbed: Callable[[Array], Pose]) -> Array:
        steps = 1e-6 * np.eye(6)
        both = [(residual(disturbed(step)), residual(disturbed(-step))) for step in steps]
        return np.stack([(more - less) / 2e-6 for more, less in both], axis=1)

    by_pose = by(camera_from_base.disturbed)
    by_robot = by(lambda step: camera_from_base @ Pose.identity().disturbed(step))
    covariance = np.eye(len(by_robot)) + by_robot * variances @ by_robot.T
    weighted = np.linalg.solve(covariance, by_pose).T
    np.testing.assert_allclose(view.root.T @ view.root, weighted @ by_pose, rtol=1e-6, atol=1e-2)
    np.testing.assert_allclose(
        view.root.T @ view.residual, weighted @ residual(camera_from_base), rtol=1e-6, atol=1e-3
    )
