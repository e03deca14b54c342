"""A face's sigma is the error of its corners: by the picture's noise, and by their scatter."""

import numpy as np
import pytest
from boards import (
    Placed,
    aprilgrid,
    charuco,
    checkerboard,
    fine_picture_of,
    placed,
    target_of,
    true_pixels,
)

from trigpoint.edge.detector import detector_for
from trigpoint.edge.registration.measurement import LEAST_SIGMA_PX, sigma_of
from trigpoint.target import Face

VIEWS = 8


def view(board: Face, distance: float, number: int) -> Placed:
    """One of VIEWS, from all sides."""
    return placed(
        board,
        distance=distance + 0.02 * number,
        turn_deg=11 * number,
        tilt_deg=10 * number - 35,
        yaw_deg=7 * number - 20,
    )


@pytest.mark.parametrize(("noise", "blur_px"), [(2.0, 0.5), (2.0, 1.2), (10.0, 0.8)])
@pytest.mark.parametrize(
    ("board", "distance"), [(checkerboard(), 0.9), (charuco(), 1.0), (aprilgrid(), 1.2)]
)
def test_sigma_is_the_error(board: Face, distance: float, noise: float, blur_px: float) -> None:
    detector = detector_for([target_of(board)])
    squares = []
    for number in range(VIEWS):
        seen = view(board, distance, number)
        picture = fine_picture_of([seen], noise=noise, blur_px=blur_px, seed=number)
        (face,) = detector.detect(picture)
        off = face.pixels - true_pixels(seen)[face.corners.astype(int)]
        squares.append(np.mean(off**2) / face.sigma**2)
    assert 0.9 < np.sqrt(np.mean(squares)) < 1.1


def test_scatter_of_many_corners_outweighs_the_noise() -> None:
    noise = np.full(48, 0.01)
    assert sigma_of(noise, 86 * 0.015**2, 86) == pytest.approx(0.015, rel=0.02)


def test_noise_speaks_for_corners_that_cannot_scatter() -> None:
    assert sigma_of(np.array([0.01, 0.02, 0.03, 0.03]), 0.0, 0) == pytest.approx(0.024, rel=0.01)


def test_few_corners_of_a_board_that_is_not_flat_are_not_called_sharp() -> None:
    assert sigma_of(np.full(12, 0.005), 14 * 0.1**2, 14) == pytest.approx(0.1, rel=0.01)


def test_no_corner_is_called_truer_than_it_can_be_drawn() -> None:
    assert sigma_of(np.full(12, 1e-6), 0.0, 14) == LEAST_SIGMA_PX
