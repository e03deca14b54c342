"""What a homography and a lens leave of a face is taken up where it is smooth, and nowhere else."""

import numpy as np

from trigpoint.edge.registration.bend import Bend

POINTS = np.stack(np.meshgrid(np.arange(9.0), np.arange(6.0)), axis=-1).reshape(-1, 2)


def curl(points: np.ndarray) -> np.ndarray:
    """Paper that lifts at one side, pixels."""
    return np.column_stack([0.02 * points[:, 0] ** 2, 0.004 * points[:, 1] ** 3])


def test_curl_is_taken_up() -> None:
    flat = np.column_stack([np.ones(len(POINTS)), POINTS])
    left = curl(POINTS) - flat @ np.linalg.lstsq(flat, curl(POINTS))[0]
    bend = Bend.of(POINTS, left)
    assert bend is not None
    again = left - bend.at(POINTS)
    again -= flat @ np.linalg.lstsq(flat, again)[0]
    assert np.abs(left).max() > 0.15
    assert np.abs(again).max() < 0.05


def test_one_wild_corner_is_not() -> None:
    left = np.zeros((len(POINTS), 2))
    left[20] = 3.0
    bend = Bend.of(POINTS, left)
    assert bend is not None
    assert np.abs(left - bend.at(POINTS))[20].min() > 2.0


def test_few_corners_have_none() -> None:
    assert Bend.of(POINTS[:8], np.ones((8, 2))) is None
    assert Bend.of(POINTS[:9], np.ones((9, 2))) is None  # a line
