"""Corners by laying the print over the picture, under what cameras make of it."""

import cv2
import numpy as np
from support.pictures.boards import CAMERA, charuco, fine_picture_of, placed, true_pixels

from trigpoint.edge.registration.blur import SHARP, Blur
from trigpoint.edge.registration.corner_pattern import CornerPattern
from trigpoint.edge.registration.measurement import Measured, measured
from trigpoint.edge.registration.planar_fit import PlanarFit
from trigpoint.edge.registration.plane_fitting import fit_plane

BOARD = charuco(5, 4)
SIZE = (CAMERA.width, CAMERA.height)
VIEW = placed(BOARD, distance=0.9, turn_deg=20, tilt_deg=35, yaw_deg=-30)


def plane(off_px: float = 0.0) -> PlanarFit:
    """Where BOARD is, but for `off_px` each way."""
    fit = fit_plane(CornerPattern.of(BOARD).points, true_pixels(VIEW) + off_px, SIZE)
    assert fit is not None
    return fit


def measured_from(picture: np.ndarray, off_px: float = 0.4, blur: Blur = SHARP) -> Measured:
    """What is measured of BOARD from nearly where it is."""
    found = measured(picture, CornerPattern.of(BOARD), plane(off_px), blur=blur)
    assert found is not None
    return found


def errors(found: Measured) -> np.ndarray:
    return found.pixels - true_pixels(VIEW)[found.corners]


def rms(found: Measured) -> float:
    return float(np.sqrt(np.mean(errors(found) ** 2)))


def grid() -> tuple[np.ndarray, np.ndarray]:
    """x and y of every pixel, float32."""
    x, y = np.meshgrid(*(np.arange(count, dtype=np.float32) for count in SIZE))
    return x, y


def sharpened(picture: np.ndarray, strength: float, sigma_px: float) -> np.ndarray:
    """What a camera's unsharp mask makes of a picture."""
    soft = cv2.GaussianBlur(picture.astype(np.float32), (0, 0), sigma_px)
    return np.clip(picture + strength * (picture - soft), 0, 255).round().astype(np.uint8)


def test_a_camera_that_sharpens_is_drawn_with_its_halos() -> None:
    light = fine_picture_of([VIEW], noise=1.0).astype(np.float32) * 0.5 + 60
    found = measured_from(sharpened(light, 2.0, 1.0))
    assert len(found.corners) == BOARD.corner_count
    assert rms(found) < 0.02
    assert found.blur.variances[:2].sum() < 0
    assert found.sigma < 0.03


def test_light_that_clips_moves_no_corner() -> None:
    bright = fine_picture_of([VIEW], noise=1.0, blur_px=1.2).astype(np.float32) * 2.0
    found = measured_from(np.clip(bright, 0, 255).astype(np.uint8))
    assert len(found.corners) == BOARD.corner_count
    assert rms(found) < 0.02
    assert found.blur.response > 0.3
    assert found.sigma < 0.05


def test_light_from_one_side_moves_no_corner() -> None:
    picture = fine_picture_of([VIEW], noise=1.0, blur_px=1.0)
    x, y = true_pixels(VIEW).mean(axis=0)
    columns, rows = grid()
    light = np.exp((0.6 * (columns - x) - 0.8 * (rows - y)) / 100)
    found = measured_from((np.minimum(0.7 * picture * light, 255)).astype(np.uint8))
    assert len(found.corners) == BOARD.corner_count
    assert rms(found) < 0.02


def test_a_corner_of_a_board_that_curls_is_found_off_the_plane() -> None:
    picture = fine_picture_of([VIEW], noise=1.0, blur_px=1.2)
    x, y = true_pixels(VIEW)[0]
    columns, rows = grid()
    far = (columns - np.float32(x)) ** 2 + (rows - np.float32(y)) ** 2
    curl = 2.5 * np.exp(-far / (2 * 40**2))
    curled = cv2.remap(picture, columns - curl, rows + curl, cv2.INTER_CUBIC)
    found = measured_from(curled, 0.0)
    assert len(found.corners) == BOARD.corner_count
    assert np.allclose(errors(found)[0], [2.5, -2.5], atol=0.1)
    off_plane = found.fit.project(CornerPattern.of(BOARD).points) - found.pixels
    assert found.sigma > 0.8 * np.sqrt(np.mean(off_plane**2))


def test_one_step_leads_there() -> None:
    """No other is taken from so near: derivatives that are too low by a twentieth would leave as
    much of the way."""
    picture = fine_picture_of([VIEW], noise=0.0, blur_px=0.6)
    blur = measured_from(picture).blur
    there, beside = (measured_from(picture, off_px, blur) for off_px in (0.0, 0.08))
    assert np.abs((beside.pixels - there.pixels).mean(axis=0)).max() < 0.002


def test_no_corner_is_called_truer_than_it_can_be_drawn() -> None:
    assert measured_from(fine_picture_of([VIEW], noise=0.0)).sigma >= 0.003
