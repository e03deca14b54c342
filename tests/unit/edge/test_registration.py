"""Corners by laying the print over the picture, under what cameras make of it."""

import cv2
import numpy as np
from boards import charuco, fine_picture_of, placed, true_pixels

from trigpoint.edge.measurement import Measured, measured
from trigpoint.edge.patches import CornerPattern
from trigpoint.edge.planar_fit import fit_plane

BOARD = charuco(5, 4)
VIEW = placed(BOARD, distance=0.9, turn_deg=20, tilt_deg=35, yaw_deg=-30)


def measured_from(picture: np.ndarray, *, off_px: float = 0.4) -> Measured:
    """What is measured of BOARD from where it is, but for `off_px` each way."""
    pattern, truth = CornerPattern.of(BOARD), true_pixels(VIEW)
    fit = fit_plane(pattern.points, truth + off_px, (picture.shape[1], picture.shape[0]))
    assert fit is not None
    found = measured(picture, pattern, fit)
    assert found is not None
    return found


def errors(found: Measured) -> np.ndarray:
    return found.pixels - true_pixels(VIEW)[found.corners]


def sharpened(picture: np.ndarray, strength: float, sigma_px: float) -> np.ndarray:
    """What a camera's unsharp mask makes of a picture."""
    soft = cv2.GaussianBlur(picture.astype(np.float32), (0, 0), sigma_px)
    return np.clip(picture + strength * (picture - soft), 0, 255).round().astype(np.uint8)


def test_a_camera_that_sharpens_is_drawn_with_its_halos() -> None:
    light = fine_picture_of([VIEW], noise=1.0).astype(np.float32) * 0.5 + 60
    found = measured_from(sharpened(light, 2.0, 1.0))
    assert len(found.corners) == BOARD.corner_count
    assert np.sqrt(np.mean(errors(found) ** 2)) < 0.02
    assert found.blur[0] + found.blur[1] < 0
    assert found.sigma < 0.03
