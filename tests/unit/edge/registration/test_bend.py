"""What a homography and a lens leave of a face is taken up where it is smooth, and nowhere else."""

import numpy as np

from trigpoint.edge.registration.plane_fitting import settled_fit

POINTS = np.stack(np.meshgrid(np.arange(9.0), np.arange(6.0)), axis=-1).reshape(-1, 2)
SIZE = (640, 480)
ENOUGH_PX = 0.01
# Where a packed fit has the degree of its bend, 0 for none.
DEGREE = 20
FLAT = 60.0 + 50.0 * POINTS


def curl(points: np.ndarray) -> np.ndarray:
    """Paper that is wavy along one side, pixels."""
    return np.column_stack([np.zeros(len(points)), 0.4 * np.sin(0.8 * points[:, 0])])


def test_curl_is_taken_up() -> None:
    pixels = FLAT + curl(POINTS)
    fit = settled_fit(POINTS, pixels, SIZE, ENOUGH_PX)
    rough = settled_fit(POINTS, pixels, SIZE, 10.0)
    assert fit is not None
    assert fit.packed[DEGREE] > 0
    assert rough is not None
    assert rough.residuals(POINTS, pixels).max() > 0.25
    assert fit.residuals(POINTS, pixels).max() < 0.15


def test_one_wild_corner_is_not() -> None:
    pixels = FLAT.copy()
    pixels[20] += 3.0
    fit = settled_fit(POINTS, pixels, SIZE, ENOUGH_PX)
    assert fit is not None
    assert fit.residuals(POINTS, pixels)[20] > 2.0


def test_few_corners_have_none() -> None:
    fit = settled_fit(
        POINTS[[0, 1, 9, 10, 20, 33, 40]], np.arange(14.0).reshape(7, 2) ** 1.5, SIZE, 0
    )
    assert fit is None or fit.packed[DEGREE] == 0
