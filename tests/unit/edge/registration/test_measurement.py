"""A face's sigma is the error of its corners: by the picture's noise, and by their scatter."""

import numpy as np
import pytest
from support.pictures.boards import (
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
from trigpoint.site.target import Face

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


@pytest.mark.parametrize(
    ("board", "distance", "noise", "blur_px"),
    [
        (checkerboard(), 0.9, 2.0, 0.5),
        (checkerboard(), 0.9, 10.0, 0.8),
        (charuco(), 1.0, 2.0, 1.2),
        (charuco(), 1.0, 10.0, 0.8),
        (aprilgrid(), 1.2, 2.0, 0.5),
        (aprilgrid(), 1.2, 2.0, 1.2),
    ],
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
    assert 0.88 < np.sqrt(np.mean(squares)) < 1.12
