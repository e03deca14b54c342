from collections.abc import Callable

import cv2
import numpy as np
import pytest

from trigpoint.geometry import CameraModel
from trigpoint.geometry.camera import LensModel
from trigpoint.geometry.rotation import Array

PLUMB_BOB = CameraModel(640, 480, 500.0, 510.0, 322.0, 238.0, (-0.28, 0.09, 1e-3, -2e-3, 0.01))
RATIONAL = CameraModel(
    1280,
    720,
    900.0,
    905.0,
    640.0,
    360.0,
    (0.3, -0.1, 1e-3, 5e-4, 0.02, 0.5, -0.05, 0.01),
    LensModel.RATIONAL_POLYNOMIAL,
)
FISHEYE = CameraModel(
    640, 480, 300.0, 301.0, 320.0, 240.0, (0.02, -0.01, 3e-3, -1e-3), LensModel.EQUIDISTANT
)
IDEAL = CameraModel.from_field_of_view(640, 480, np.radians(60.0))
CAMERAS = [PLUMB_BOB, RATIONAL, FISHEYE, IDEAL]
every_camera = pytest.mark.parametrize("camera", CAMERAS, ids=lambda c: c.model.value)


def points_ahead() -> Array:
    """Points well inside every camera's picture, and one on the axis."""
    random = np.random.default_rng(4)
    points = random.uniform([-0.8, -0.6, 2.0], [0.8, 0.6, 4.0], (50, 3))
    return np.vstack([points, [0.0, 0.0, 3.0]])


@every_camera
def test_projection_agrees_with_opencv(camera: CameraModel) -> None:
    points, none = points_ahead(), np.zeros(3)
    distortion = np.array(camera.distortion)
    if camera.model is LensModel.EQUIDISTANT:
        expected, _ = cv2.fisheye.projectPoints(
            points.reshape(-1, 1, 3), none, none, camera.matrix, distortion
        )
    else:
        expected, _ = cv2.projectPoints(points, none, none, camera.matrix, distortion)
    np.testing.assert_allclose(camera.project(points), expected.reshape(-1, 2), atol=1e-9)


def differences(function: Callable[[Array], Array], start: Array, step: float) -> Array:
    """Derivative of `function` by the last dimension of its argument."""
    columns = [
        (function(start + step * axis) - function(start - step * axis)) / (2 * step)
        for axis in np.eye(start.shape[-1])
    ]
    return np.stack(columns, axis=-1)


@every_camera
def test_jacobians_agree_with_finite_differences(camera: CameraModel) -> None:
    points = points_ahead()
    pixels, by_point, by_parameters = camera.project_jacobians(points)
    np.testing.assert_allclose(pixels, camera.project(points), atol=1e-12)
    np.testing.assert_allclose(by_point, differences(camera.project, points, 1e-6), atol=1e-4)
    numeric = differences(
        lambda parameters: camera.with_parameters(parameters).project(points),
        camera.parameters,
        1e-6,
    )
    np.testing.assert_allclose(by_parameters, numeric, atol=1e-4)


@every_camera
def test_directions_undo_projection(camera: CameraModel) -> None:
    points = points_ahead()
    directions = camera.directions(camera.project(points))
    np.testing.assert_allclose(directions, points[:, :2] / points[:, 2:], atol=1e-8)


@every_camera
def test_parameters_make_the_camera_again(camera: CameraModel) -> None:
    assert camera.with_parameters(camera.parameters) == camera


def test_what_is_outside_or_behind_is_not_seen() -> None:
    points = np.array([[0.0, 0, 2], [0, 0, -2], [5, 0, 2], [0, 5, 2], [0, 0, 0]])
    assert PLUMB_BOB.sees(points).tolist() == [True, False, False, False, False]


def test_direction_beyond_the_lens_models_fold_is_not_seen() -> None:
    folding = CameraModel(640, 480, 300.0, 300.0, 320.0, 240.0, (-0.5, 0.0, 0.0, 0.0, 0.0))
    angles = np.linspace(0, 1.4, 200)
    points = np.stack([np.sin(angles), np.zeros_like(angles), np.cos(angles)], axis=-1)
    seen = folding.sees(points)
    assert seen[0]
    assert not seen[-1]
    first_unseen = int(np.argmin(seen))
    assert not seen[first_unseen:].any()
    pixels = folding.project(points[seen])[:, 0]
    assert np.all(np.diff(pixels) > 0)


def test_nominal_camera_has_its_field_of_view() -> None:
    left, right = IDEAL.directions([[-0.5, 239.5], [639.5, 239.5]])
    np.testing.assert_allclose(np.degrees(np.arctan(right[0]) - np.arctan(left[0])), 60.0)


def test_missing_coefficients_are_zeros() -> None:
    assert CameraModel(2, 2, 1, 1, 0, 0, (0.1,)).distortion == (0.1, 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"width": 0}, "positive width"),
        ({"fx": -1.0}, "focal length"),
        ({"fx": float("nan")}, "focal length"),
        ({"cx": float("inf")}, "finite"),
        ({"distortion": (0.0,) * 6}, "plumb_bob has 5"),
    ],
)
def test_impossible_camera_is_refused(changes: dict[str, object], complaint: str) -> None:
    values: dict[str, object] = {
        "width": 640,
        "height": 480,
        "fx": 1.0,
        "fy": 1.0,
        "cx": 0,
        "cy": 0,
    }
    with pytest.raises(ValueError, match=complaint):
        CameraModel(**values | changes)  # pyright: ignore[reportArgumentType]
