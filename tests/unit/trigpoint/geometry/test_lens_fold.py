"""A lens polynomial folds back far outside the picture and may rise again."""

import numpy as np

from trigpoint.geometry import CameraModel
from trigpoint.geometry.camera import LensModel


def test_a_direction_beyond_the_fold_is_not_seen_though_its_pixel_is_inside() -> None:
    camera = CameraModel(640, 480, 540, 540, 320, 240, (-0.21, 0.062, 0, 0, -0.007))
    far = np.array([[tangent, 0.0, 1.0] for tangent in np.linspace(1.5, 8.0, 200)])
    pixels = camera.project(far)
    comes_back = (pixels[:, 0] > 0) & (pixels[:, 0] < 639)
    assert comes_back.any()
    assert not camera.sees(far).any()


def test_a_lens_that_never_folds_sees_to_the_edge_of_its_picture() -> None:
    wide = CameraModel(640, 480, 180, 180, 320, 240, (0, 0, 0, 0), LensModel.EQUIDISTANT)
    assert wide.sees(np.array([[3.0, 0.0, 1.0], [0.0, 0.0, 1.0]])).all()
