"""Errors of poses that a rigid motion of the whole map shares."""

import numpy as np
import pytest

from trigpoint.fusion.estimators.filters.pose_errors import (
    disturbance_by_twist,
    twist_between,
    twist_by_disturbance,
    twisted,
)
from trigpoint.geometry import Pose

STEP = 1e-6


def some_poses() -> Pose:
    random = np.random.default_rng(5)
    spread = np.repeat([4.0, 0.8], 3)
    return Pose.from_vector(spread * random.standard_normal((4, 6)))


@pytest.mark.parametrize("size", [0.0, 1e-5, 0.3, 2.0])
def test_twist_between_two_poses_takes_one_to_the_other(size: float) -> None:
    poses = some_poses()
    twists = size * np.array([3.0, -1.0, 0.5, 0.4, -0.2, 0.9]) * np.ones((4, 1))
    np.testing.assert_allclose(twist_between(poses, twisted(poses, twists)), twists, atol=1e-9)


def test_one_twist_moves_all_poses_as_a_rigid_body() -> None:
    poses, twist = some_poses(), np.array([2.0, -1.0, 0.5, 0.4, -0.7, 0.9])
    moved = twisted(poses, np.tile(twist, (4, 1)))
    relative, before = moved[0].inverse() @ moved, poses[0].inverse() @ poses
    np.testing.assert_allclose(relative.difference(before), 0.0, atol=1e-12)


def test_small_twist_is_a_disturbance_and_back() -> None:
    poses = some_poses()
    for axis in range(6):
        twist = STEP * np.eye(6)[axis] * np.ones((4, 1))
        disturbance = twisted(poses, twist).difference(poses) / STEP
        np.testing.assert_allclose(
            disturbance, disturbance_by_twist(poses)[..., axis], rtol=1e-4, atol=1e-4
        )
    there_and_back = twist_by_disturbance(poses) @ disturbance_by_twist(poses)
    np.testing.assert_allclose(there_and_back, np.tile(np.eye(6), (4, 1, 1)), atol=1e-12)
