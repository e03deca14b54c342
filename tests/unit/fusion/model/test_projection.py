"""Derivatives of projected corners against finite differences."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.fusion.drives import lens

from trigpoint.fusion.model.prediction import batch_jacobian
from trigpoint.fusion.model.problem import Batch, CameraState, RobotState, State
from trigpoint.fusion.model.projection import NEAREST_M, projected
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.camera import LensModel
from trigpoint.geometry.rotation import Array

STEP = 1e-6
LENSES = [
    CameraModel(640, 480, 500.0, 510.0, 320.0, 240.0, distortion, model)
    for model, distortion in (
        (LensModel.PLUMB_BOB, (-0.2, 0.05, 1e-3, -2e-3, 0.01)),
        (LensModel.RATIONAL_POLYNOMIAL, (0.3, 0.1, 1e-3, -2e-3, 0.01, 0.5, 0.2, 0.02)),
        (LensModel.EQUIDISTANT, (-0.02, 0.01, 2e-3, -1e-3)),
    )
]
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


@pytest.mark.parametrize("camera", LENSES, ids=lambda camera: camera.model)
def test_core_projects_as_the_lens_says(camera: CameraModel) -> None:
    pose, points = scene()
    found = projected(camera, pose, points)
    assert_allclose(found.pixels, camera.project(pose @ points), rtol=1e-12)
    slope = slopes(lambda moved: projected(camera, moved, points).pixels, pose)
    assert_allclose(found.by_body, slope, rtol=1e-6, atol=1e-4)


@pytest.mark.parametrize("camera", LENSES, ids=lambda camera: camera.model)
def test_derivatives_by_a_lens_are_the_models(camera: CameraModel) -> None:
    pose, points = scene()
    pixels, _, by_lens = camera.project_jacobians(pose @ points)
    count, corners = points.shape[:2]
    weights = np.full((count, corners), 4.0)
    batch = Batch(
        "c1", "r1", np.arange(count), points, np.zeros((count, corners), dtype=int),
        np.zeros_like(pixels), weights, np.ones(count), np.arange(count), np.zeros(count),
    )  # fmt: skip
    here = Pose.stack([Pose.identity()])
    robot = RobotState(pose, base_from_face=here, scales=np.zeros(2))
    state = State({"c1": CameraState(here[0], camera)}, {"r1": robot})
    columns = {"c1": np.arange(6)}
    layout = SimpleNamespace(pose=columns, lens={"c1": np.arange(by_lens.shape[-1])}, faces={})
    problem: Any = SimpleNamespace(
        chains={"r1": SimpleNamespace(tangent=list(range(6)))}, layout=layout
    )
    jacobian, residual, _ = batch_jacobian(problem, batch, state)
    assert_allclose(residual, 4 * pixels, rtol=1e-12)
    assert_allclose(jacobian[..., 12:], 4 * by_lens, rtol=1e-9, atol=1e-9)
    assert_allclose(jacobian[..., :3], -jacobian[..., 6:9])  # the camera moves the other way


def test_corner_behind_the_camera_is_pushed_before_it() -> None:
    points = np.array([[0.001, 0.0, -1.0], [0.001, 0.0, 1.0]])
    found = projected(lens(), Pose.identity(), points)
    assert found.is_ahead.tolist() == [False, True]
    assert_allclose(found.pixels[0], lens().project([0.001, 0.0, NEAREST_M]))
