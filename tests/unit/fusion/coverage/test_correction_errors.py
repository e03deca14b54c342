"""The errors that pictures of several cameras leave, against least squares written out in full."""

from functools import cache

import numpy as np
import pytest
from scipy.special import erf

from trigpoint.fusion.coverage.correction_errors import (
    MOST_CAMERAS,
    Pictures,
    expected_errors,
    radius,
)
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import lever

PLANAR = (0, 1, 5)


def covariance_of(cameras: int, *, seed: int = 1) -> Array:
    """A joint covariance with strong correlations between the cameras."""
    root = np.random.default_rng(seed).normal(size=(6 * cameras, 8)) * 0.003
    return root @ root.T + 1e-7 * np.eye(6 * cameras)


def pictures(cameras: list[int], *, seed: int = 2) -> Pictures:
    random = np.random.default_rng(seed)
    roots = random.normal(size=(len(cameras), 24, 6)) * 300.0
    return Pictures(
        np.zeros(len(cameras), dtype=int),
        np.array(cameras),
        np.swapaxes(roots, 1, 2) @ roots,
        random.uniform(-3.0, 3.0, (len(cameras), 3)),
    )


def by_joint_least_squares(found: Pictures, covariance: Array) -> Array:
    """The covariance of x and y with every camera's error an unknown beside the robot's pose: the
    least that any estimator can have."""
    count = len(covariance)
    information = np.zeros((3 + count, 3 + count))
    information[3:, 3:] = np.linalg.inv(covariance)
    for camera, picture, arm in zip(found.camera, found.information, found.arm, strict=True):
        jacobian = np.zeros((6, 3 + count))
        jacobian[list(PLANAR), [0, 1, 2]] = 1.0
        jacobian[:, 3 + 6 * camera : 9 + 6 * camera] = -lever(arm)
        information += jacobian.T @ picture @ jacobian
    return np.linalg.inv(information)[:2, :2]


def errors(found: Pictures, cameras: int, tangent: tuple[int, ...] = PLANAR):
    return expected_errors(found, 1, covariance_of(cameras), tangent)


@pytest.mark.parametrize(
    "covariance",
    [np.diag([1.0, 1.0]), np.diag([1.0, 1e-6]), np.array([[2.0, 0.9], [0.9, 0.5]])],
)
def test_the_radius_holds_95_percent(covariance: Array) -> None:
    drawn = np.random.default_rng(3).multivariate_normal([0, 0], covariance, 200_000)
    inside = np.mean(np.linalg.norm(drawn, axis=1) <= radius(covariance))
    assert inside == pytest.approx(0.95, abs=0.002)


@cache
def strips_of_a_quarter() -> tuple[Array, Array]:
    """Angles up to a quarter of a turn either way, and their weights."""
    angles, weights = np.polynomial.legendre.leggauss(2000)
    return 0.5 * np.pi * angles, 0.5 * np.pi * weights


@pytest.mark.parametrize("ratio", [0.0, 0.005, 0.3, 0.995, 1.0])
def test_the_radius_is_exact(ratio: float) -> None:
    """Of an ellipse of any shape, by integration over strips along its longer axis."""
    reach = float(radius(np.diag([1.0, ratio**2])))
    angles, weights = strips_of_a_quarter()
    along, beside = reach * np.sin(angles), reach * np.cos(angles)
    strips = (
        np.exp(-0.5 * along**2) / np.sqrt(2 * np.pi) * erf(beside / np.sqrt(2) / max(ratio, 1e-12))
    )
    assert strips * beside @ weights == pytest.approx(0.95, abs=1e-9)


def test_one_picture_is_worth_what_joint_least_squares_make_of_it() -> None:
    found = pictures([1])
    least = radius(by_joint_least_squares(found, covariance_of(3)))
    assert errors(found, 3).by_pose[0] == pytest.approx(float(least), rel=1e-6)
    assert errors(found, 3).without[0] == np.inf


@pytest.mark.parametrize("count", [2, 3, 6])
def test_several_pictures_are_worth_what_joint_least_squares_make_of_them(count: int) -> None:
    found = pictures(list(range(count)))
    least = float(radius(by_joint_least_squares(found, covariance_of(count))))
    assert errors(found, count).by_pose[0] == pytest.approx(least, rel=1e-5)


def test_without_a_camera_is_as_if_its_picture_had_not_been_taken() -> None:
    found = pictures([0, 1, 2, 3])
    left = errors(found, 4).without
    for index in range(4):
        others = found.where(np.arange(4) != index)
        assert left[index] == pytest.approx(float(errors(others, 4).by_pose[0]), rel=1e-6)


def test_of_many_pictures_the_best_count_and_the_others_can_fail() -> None:
    found = pictures(list(range(MOST_CAMERAS + 2)))
    weights = np.ones(len(found.pose))
    weights[[1, 4]] = 1e-4
    weak = Pictures(found.pose, found.camera, found.information * weights[:, None, None], found.arm)
    all_of_them = errors(weak, MOST_CAMERAS + 2)
    strong = errors(weak.where(weights == 1), MOST_CAMERAS + 2)
    assert all_of_them.by_pose[0] == pytest.approx(float(strong.by_pose[0]), rel=1e-9)
    assert all_of_them.without[[1, 4]] == pytest.approx(all_of_them.by_pose[0])
    assert np.all(all_of_them.without[weights == 1] > all_of_them.by_pose[0])


def test_a_picture_that_leaves_a_direction_open_corrects_nothing() -> None:
    found = pictures([0])
    along = np.zeros(6)
    along[0] = 1.0
    keeps = np.eye(6) - np.outer(along, along)
    blind = Pictures(found.pose, found.camera, keeps @ found.information @ keeps, found.arm)
    assert errors(blind, 1).by_pose[0] == np.inf


def test_poses_without_pictures_are_not_corrected() -> None:
    found = pictures([0])
    spread = Pictures(np.array([2]), found.camera, found.information, found.arm)
    by_pose = expected_errors(spread, 4, covariance_of(1), PLANAR).by_pose
    assert np.isfinite(by_pose).tolist() == [False, False, True, False]


def test_a_robot_in_space_is_known_less_well_than_one_on_the_floor() -> None:
    found = pictures([0, 1])
    assert errors(found, 2, (0, 1, 2, 3, 4, 5)).by_pose[0] > errors(found, 2).by_pose[0]
