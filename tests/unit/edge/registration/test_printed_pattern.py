"""Where a board's markers are printed."""

import cv2
import numpy as np
import pytest

from trigpoint.edge.registration.printed_pattern import charuco_layout
from trigpoint.site.target import NOWHERE, Face, Pattern

# In binary fractions of a metre, which OpenCV's single precision has exactly.
SQUARE, MARKER = 0.0625, 0.046875


@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize(("columns", "rows"), [(5, 4), (4, 5), (6, 4), (7, 5), (8, 11), (3, 2)])
def test_markers_lie_where_opencv_has_them(columns: int, rows: int, legacy: bool) -> None:
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_250)
    board = cv2.aruco.CharucoBoard((columns, rows), SQUARE, MARKER, dictionary)
    board.setLegacyPattern(legacy)
    face = Face(
        *(0, Pattern.CHARUCO, columns, rows, SQUARE, *NOWHERE),
        marker=MARKER,
        dictionary="DICT_4X4_250",
        legacy=legacy,
    )
    corners = np.array(board.getObjPoints(), float)[:, :, :2]
    np.testing.assert_allclose(charuco_layout(face) + SQUARE, corners, rtol=0, atol=1e-9)
