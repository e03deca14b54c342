"""The map of corrections, as a picture over the floor."""

import io

import numpy as np
import pytest
from PIL import Image

from trigpoint.geometry import Pose
from trigpoint.tools.board.grid import grid_picture


def test_cells_are_coloured_and_lie_where_they_are() -> None:
    values = np.full((30, 20), -1, dtype=np.int8)
    values[4, 7], values[5, 7] = 0, 100  # row 4, column 7: up and right of the corner
    found = grid_picture(0.5, Pose.planar(1.0, 2.0, np.pi / 2), values)
    assert found is not None
    pixels = np.asarray(Image.open(io.BytesIO(found.png)))
    assert np.argwhere(pixels[..., 3]).tolist() == [[24, 7], [25, 7]]
    best, worst = pixels[25, 7].astype(int), pixels[24, 7].astype(int)
    assert best[1] > best[0]  # green
    assert worst[0] > worst[1]  # red
    a, b, c, d, e, f = found.fields["matrix"]  # pyright: ignore
    x, y = a * 7.5 + c * 25.5 + e, b * 7.5 + d * 25.5 + f
    # The cell's middle is 3.75 m along the rows and 2.25 m across, turned by a quarter.
    assert (x, y) == pytest.approx((1.0 - 2.25, 2.0 + 3.75))
    assert found.fields["size"] == [20, 30]


def test_an_empty_grid_is_none() -> None:
    assert grid_picture(0.1, Pose.planar(0, 0, 0), np.zeros((0, 5), np.int8)) is None
