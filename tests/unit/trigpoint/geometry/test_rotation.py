import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from trigpoint.geometry import rotation as so3
from trigpoint.geometry.rotation import Array

vectors = arrays(float, 3, elements=st.floats(-10.0, 10.0))
LENGTHS = [0.0, 1e-12, 1e-9, 1e-6, 9.9e-5, 1.01e-4, 1e-3, 0.5, 3.0, np.pi - 1e-6, np.pi - 1e-9]


@st.composite
def directions(draw: st.DrawFn) -> Array:
    vector = draw(vectors.filter(lambda v: np.linalg.norm(v) > 1e-3))
    return vector / np.linalg.norm(vector)


@settings(max_examples=150)
@given(length=st.sampled_from(LENGTHS), direction=directions())
def test_exp_and_log_are_inverse(length: float, direction: Array) -> None:
    vector = length * direction
    np.testing.assert_allclose(so3.log(so3.exp(vector)), vector, atol=1e-9)


@given(direction=directions())
def test_log_of_half_a_turn_is_one_of_its_two_vectors(direction: Array) -> None:
    vector = so3.log(so3.exp(np.pi * direction))
    np.testing.assert_allclose(np.abs(vector @ direction), np.pi, atol=1e-6)


@given(vector=vectors)
def test_exp_is_a_rotation(vector: Array) -> None:
    matrix = so3.exp(vector)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(matrix), 1.0, atol=1e-12)


@given(first=vectors, second=vectors)
def test_hat_is_the_cross_product(first: Array, second: Array) -> None:
    np.testing.assert_allclose(so3.hat(first) @ second, np.cross(first, second), atol=1e-9)


@given(vector=vectors)
def test_quaternion_round_trip(vector: Array) -> None:
    matrix = so3.exp(vector)
    quaternion = so3.to_quaternion(matrix)
    np.testing.assert_allclose(np.linalg.norm(quaternion), 1.0, atol=1e-12)
    assert quaternion[3] >= 0
    np.testing.assert_allclose(so3.from_quaternion(quaternion), matrix, atol=1e-12)
    np.testing.assert_allclose(so3.from_quaternion(-3.0 * quaternion), matrix, atol=1e-12)


@given(vector=vectors)
def test_quaternion_of_one_rotation_is_that_of_many(vector: Array) -> None:
    matrix = so3.exp(vector)
    [of_many] = so3.to_quaternion(matrix[None])
    np.testing.assert_allclose(so3.to_quaternion(matrix), of_many, atol=1e-15)


@pytest.mark.parametrize("axis", [[np.pi, 0, 0], [0, np.pi, 0], [0, 0, np.pi]])
def test_quaternion_of_half_a_turn_about_an_axis(axis: list[float]) -> None:
    quaternion = so3.to_quaternion(so3.exp(axis))
    np.testing.assert_allclose(np.abs(quaternion), [*(np.array(axis) / np.pi), 0], atol=1e-9)


@settings(max_examples=100)
@given(length=st.sampled_from([0.0, 1e-5, 1e-3, 0.5, 2.0, 3.1]), direction=directions())
def test_left_jacobian_agrees_with_finite_differences(length: float, direction: Array) -> None:
    vector, step = length * direction, 1e-6
    numeric = np.stack(
        [
            so3.log(so3.exp(vector + step * axis) @ so3.exp(vector - step * axis).T) / (2 * step)
            for axis in np.eye(3)
        ],
        axis=-1,
    )
    np.testing.assert_allclose(so3.left_jacobian(vector), numeric, atol=1e-6)


def test_leading_dimensions_are_kept() -> None:
    batch = np.linspace(-3, 3, 30).reshape(2, 5, 3)
    matrices = so3.exp(batch)
    assert matrices.shape == (2, 5, 3, 3)
    np.testing.assert_allclose(matrices[1, 3], so3.exp(batch[1, 3]), atol=1e-15)
    np.testing.assert_allclose(so3.log(matrices)[0, 2], so3.log(matrices[0, 2]), atol=1e-15)
    np.testing.assert_allclose(
        so3.left_jacobian(batch)[1, 0], so3.left_jacobian(batch[1, 0]), atol=1e-15
    )


@given(st.floats(-50.0, 50.0))
def test_wrapped_angle_is_the_same_direction(angle: float) -> None:
    wrapped = so3.wrap(angle)
    assert -np.pi <= wrapped < np.pi
    np.testing.assert_allclose(np.cos(wrapped), np.cos(angle), atol=1e-9)
    np.testing.assert_allclose(np.sin(wrapped), np.sin(angle), atol=1e-9)


def test_turning_about_z_takes_x_to_y() -> None:
    np.testing.assert_allclose(so3.about_z(np.pi / 2) @ [1.0, 0, 0], [0, 1.0, 0], atol=1e-15)


def test_one_quaternion_by_plain_numbers_is_the_same_to_the_last_bit() -> None:
    """So that a session gives the same network, whichever way its odometry was read."""
    for q in np.random.default_rng(0).normal(size=(300, 4)):
        q = q / np.linalg.norm(q)
        assert np.allclose(so3.of_quaternion(*q), so3.from_quaternion(q), atol=1e-15)
    for heading in np.linspace(-3, 3, 300):
        q = np.array([0.0, 0.0, np.sin(heading / 2), np.cos(heading / 2)])
        assert np.array_equal(so3.of_quaternion(*q), so3.from_quaternion(q))
