"""Derivatives of projected corners against finite differences."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.fusion.drives import lens

from trigpoint.fusion.model.projection import NEAREST_M, by_disturbance, projected
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

STEP = 1e-6
ROOM_FROM_CAMERA = Pose.from_vector([0.4, -0.2, 0.1, 0.3, -0.1, 0.2])


def scene() -> tuple[Pose, Array]:
    """Two poses of a body before a camera, in its frame, with five points each."""
    random = np.random.default_rng(3)
    places = random.normal(0.0, 0.3, (2, 6)) + np.array([0.0, 0.0, 3.0, 0.0, 0.0, 0.0])
    return Pose.from_vector(places), random.normal(0.0, 0.2, (2, 5, 3))


def slopes(pixels_of: Callable[[Pose], Array], pose: Pose) -> Array:
    columns = [
        (pixels_of(pose.disturbed(step)) - pixels_of(pose.disturbed(-step))) / (2 * STEP)
        for step in STEP * np.eye(6)
    ]
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("room_from_camera", [None, ROOM_FROM_CAMERA])
def test_pixels_follow_the_body(room_from_camera: Pose | None) -> None:
    pose, points = scene()
    if room_from_camera is not None:
        pose = room_from_camera @ pose

    def pixels_of(moved: Pose) -> Array:
        return projected(lens(), moved, points, room_from_camera).pixels

    found = projected(lens(), pose, points, room_from_camera)
    assert np.all(found.is_ahead)
    assert_allclose(found.by_body, slopes(pixels_of, pose), rtol=1e-6, atol=1e-4)


def test_camera_moves_what_it_sees_the_other_way() -> None:
    camera_from_body, points = scene()
    pose = ROOM_FROM_CAMERA @ camera_from_body
    room = pose @ points

    def pixels_of(camera: Pose) -> Array:
        return lens().project(camera.inverse() @ room)

    by_optical = lens().project_by_point(camera_from_body @ points)[1]
    by_room = by_optical @ ROOM_FROM_CAMERA.rotation.T
    found = by_disturbance(-by_room, room - ROOM_FROM_CAMERA.translation)
    assert_allclose(found, slopes(pixels_of, ROOM_FROM_CAMERA), rtol=1e-6, atol=1e-4)


def test_chosen_components_are_those_of_all() -> None:
    random = np.random.default_rng(5)
    by_point, arm = random.normal(size=(4, 2, 3)), random.normal(size=(4, 3))
    every = by_disturbance(by_point, arm)
    assert_allclose(by_disturbance(by_point, arm, [0, 1, 5]), every[..., [0, 1, 5]])


def test_corner_behind_the_camera_is_pushed_before_it() -> None:
    points = np.array([[0.001, 0.0, -1.0], [0.001, 0.0, 1.0]])
    found = projected(lens(), Pose.identity(), points)
    assert found.is_ahead.tolist() == [False, True]
    assert_allclose(found.pixels[0], lens().project([0.001, 0.0, NEAREST_M]))
