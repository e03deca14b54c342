"""Corners of dark quadrilaterals are where their straight edges meet, not where blur has them."""

import cv2
import numpy as np

from trigpoint.edge.markers.quads import QuadFinder

POINTED = np.array([[60.3, 40.0], [67.1, 61.2], [61.0, 82.4], [54.2, 61.2]])
_FINER = 8


def picture_of(quad: np.ndarray) -> np.ndarray:
    """A dark quadrilateral (4, 2) as a slightly blurred camera sees it, (120, 160)."""
    fine = np.full((120 * _FINER, 160 * _FINER), 200, np.uint8)
    corners = np.rint((quad + 0.5) * _FINER - 0.5).astype(np.int32)
    cv2.fillConvexPoly(fine, corners, (30,))
    small = cv2.resize(fine, (160, 120), interpolation=cv2.INTER_AREA)
    return cv2.GaussianBlur(small, (0, 0), 0.8)


def off(quad: np.ndarray) -> float:
    """How far the worst corner lies from the nearest one of POINTED, pixels."""
    apart = np.linalg.norm(quad[:, None] - POINTED[None], axis=-1)
    return float(apart.min(axis=1).max())


def test_corners_of_a_pointed_quadrilateral_are_where_its_edges_meet() -> None:
    (quad,) = QuadFinder().find(picture_of(POINTED))
    assert off(quad) < 0.7
