from collections.abc import Callable

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from trigpoint.geometry import Pose
from trigpoint.geometry.pose import angle_between, rows_of
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import (
    carried_covariance,
    is_positive_semidefinite,
    lever,
    planar_covariance,
    relative_jacobians,
    symmetric,
)

vectors = arrays(float, 6, elements=st.floats(-2.0, 2.0))
STEP = 1e-6


def assert_close(first: Pose, second: Pose) -> None:
    np.testing.assert_allclose(first.rotation, second.rotation, atol=1e-9)
    np.testing.assert_allclose(first.translation, second.translation, atol=1e-9)


@given(vectors)
def test_inverse_undoes(vector: Array) -> None:
    pose = Pose.from_vector(vector)
    assert_close(pose @ pose.inverse(), Pose.identity())
    assert_close(pose.inverse() @ pose, Pose.identity())


@given(vectors, vectors, arrays(float, (4, 3), elements=st.floats(-5, 5)))
def test_composition_moves_points_one_after_the_other(a: Array, b: Array, points: Array) -> None:
    a_from_b, b_from_c = Pose.from_vector(a), Pose.from_vector(b)
    np.testing.assert_allclose(
        (a_from_b @ b_from_c) @ points, a_from_b @ (b_from_c @ points), atol=1e-9
    )
    np.testing.assert_allclose(a_from_b @ points[0], (a_from_b @ points)[0], atol=1e-12)


@given(vectors, vectors)
def test_difference_undoes_disturbance(vector: Array, disturbance: Array) -> None:
    pose, small = Pose.from_vector(vector), disturbance / 2
    np.testing.assert_allclose(pose.disturbed(small).difference(pose), small, atol=1e-9)


@given(vectors)
def test_quaternion_and_translation_make_the_pose_again(vector: Array) -> None:
    pose = Pose.from_vector(vector)
    assert_close(Pose.from_quaternion(pose.translation, pose.quaternion), pose)


@given(st.floats(-5, 5), st.floats(-5, 5), st.floats(-3.1, 3.1))
def test_planar_pose_has_its_heading_and_stays_in_the_plane(
    x: float, y: float, heading: float
) -> None:
    pose = Pose.planar(x, y, heading)
    np.testing.assert_allclose(pose.heading, heading, atol=1e-12)
    np.testing.assert_allclose(pose.translation, [x, y, 0.0])
    np.testing.assert_allclose(pose.rotation[2], [0, 0, 1], atol=1e-15)


@given(vectors, vectors)
def test_angle_between_is_the_length_of_the_turn(first: Array, second: Array) -> None:
    one, other = Pose.from_vector(first), Pose.from_vector(second)
    np.testing.assert_allclose(
        angle_between(one, other), np.linalg.norm(one.difference(other)[3:]), atol=1e-6
    )


def test_poses_are_stacked_and_taken_apart() -> None:
    poses = [Pose.planar(float(i), 0.0, 0.1 * i) for i in range(3)]
    stacked = Pose.stack(poses)
    assert len(stacked) == 3
    assert len(poses[0]) == 1
    assert_close(stacked[1], poses[1])
    assert len(Pose.stack([])) == len(Pose.joined([])) == 0
    joined = Pose.joined([stacked[:1], stacked[1:]])
    assert_close(joined[2], poses[2])
    assert len(joined) == 3
    np.testing.assert_allclose(
        (stacked @ stacked.inverse()).translation, np.zeros((3, 3)), atol=1e-15
    )


def numeric_jacobian(function: Callable[[Pose], Pose], pose: Pose) -> Array:
    """Derivative of the disturbance of `function(pose)` by the disturbance of `pose`."""
    columns = [
        function(pose.disturbed(STEP * axis)).difference(function(pose.disturbed(-STEP * axis)))
        for axis in np.eye(6)
    ]
    return np.stack(columns, axis=-1) / (2 * STEP)


@given(vectors, vectors)
def test_relative_pose_follows_both_ends(a: Array, b: Array) -> None:
    first, second = Pose.from_vector(a), Pose.from_vector(b)
    by_first, by_second = relative_jacobians(first, second)
    numeric = numeric_jacobian(lambda p: p.inverse() @ second, first)
    np.testing.assert_allclose(by_first, numeric, atol=1e-4)
    numeric = numeric_jacobian(lambda p: first.inverse() @ p, second)
    np.testing.assert_allclose(by_second, numeric, atol=1e-4)


@given(vectors, vectors)
def test_what_is_fixed_to_a_pose_follows_it(a: Array, b: Array) -> None:
    pose, fixed = Pose.from_vector(a), Pose.from_vector(b)
    numeric = numeric_jacobian(lambda p: p @ fixed, pose)
    arm = (pose @ fixed).translation - pose.translation
    np.testing.assert_allclose(lever(arm), numeric, atol=1e-4)


@given(vectors, vectors, arrays(float, (6, 6), elements=st.floats(-1, 1)))
def test_covariance_is_carried_as_finite_differences_say(a: Array, b: Array, root: Array) -> None:
    parent, pose, covariance = Pose.from_vector(a), Pose.from_vector(b), root @ root.T
    numeric = numeric_jacobian(lambda p: parent @ p, pose)
    expected = numeric @ covariance @ numeric.T
    np.testing.assert_allclose(carried_covariance(parent, covariance), expected, atol=1e-4)


def test_planar_covariance_stands_in_x_y_and_heading() -> None:
    small = np.array([[1.0, 2, 3], [2, 5, 6], [3, 6, 9]])
    full = planar_covariance(small)
    np.testing.assert_array_equal(full[np.ix_([0, 1, 5], [0, 1, 5])], small)
    assert np.count_nonzero(full) == 9


def test_soundness_of_a_covariance_is_told() -> None:
    assert is_positive_semidefinite(np.eye(6))
    assert is_positive_semidefinite(np.zeros((3, 3)))
    assert not is_positive_semidefinite(np.diag([1.0, -0.1]))
    assert not is_positive_semidefinite(np.full((2, 2), np.nan))


def test_symmetric_part_of_a_matrix() -> None:
    np.testing.assert_array_equal(symmetric(np.array([[1.0, 2], [4, 3]])), [[1, 3], [3, 3]])


def test_rows_are_poses_as_the_core_takes_them() -> None:
    poses = Pose.from_vector(np.random.default_rng(4).normal(size=(5, 6)))
    rows = rows_of([poses[0], poses[1:]])
    assert rows.shape == (5, 12)
    np.testing.assert_array_equal(Pose.from_rows(rows).rotation, poses.rotation)
    np.testing.assert_array_equal(Pose.from_rows(rows[2]).translation, poses[2].translation)
    assert rows_of([]).shape == (0, 12)
    columns = Pose(
        np.asfortranarray(poses.rotation.reshape(5, 9)).reshape(5, 3, 3, order="F"),
        np.asfortranarray(poses.translation),
    )
    assert columns.rows().flags.c_contiguous
