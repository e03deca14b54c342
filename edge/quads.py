"""Finds dark quadrilaterals, which markers are, whatever dictionary they are from."""

import cv2
import numpy as np

from trigpoint.geometry.rotation import Array

# Two threshold windows, 5 and 21 pixels: on rendered moving targets they find as many markers as
# OpenCV's three at two thirds of the time.
_WINDOWS_PX = (5, 21)
# Of the picture's longer side; OpenCV's 0.03 loses markers of 4 pixels that still can be read.
_LEAST_PERIMETER = 0.02
# OpenCV compares every candidate with every other: 4500 of them, a chequered wall, took 0.7 s.
# Pictures of rooms have up to 300 pieces.
MOST_PIECES = 1000
_PIECES_WINDOW_PX = 11
_POLYGON_ACCURACY = 0.05


class QuadFinder:
    """One ArUco pass, of which every candidate is kept: those that it could not read too."""

    def __init__(self) -> None:
        parameters = cv2.aruco.DetectorParameters()
        parameters.adaptiveThreshWinSizeMin = _WINDOWS_PX[0]
        parameters.adaptiveThreshWinSizeMax = _WINDOWS_PX[1]
        parameters.adaptiveThreshWinSizeStep = _WINDOWS_PX[1] - _WINDOWS_PX[0]
        parameters.minMarkerPerimeterRate = _LEAST_PERIMETER
        parameters.polygonalApproxAccuracyRate = _POLYGON_ACCURACY
        dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
        self._detector = cv2.aruco.ArucoDetector(dictionary, parameters)

    def find(self, grey: np.ndarray) -> Array:
        """Corners (n, 4, 2) of the dark quadrilaterals, clockwise from any of the four, pixels.

        None in a picture so crowded that OpenCV would take seconds over it.
        """
        if dark_pieces(grey) > MOST_PIECES:
            return np.zeros((0, 4, 2))
        read, _, unread = self._detector.detectMarkers(grey)
        quads = [np.asarray(quad, dtype=float).reshape(4, 2) for quad in (*read, *unread)]
        return np.array(quads).reshape(-1, 4, 2)


def dark_pieces(grey: np.ndarray) -> int:
    """How many separate dark pieces of a candidate's size a picture has, at half its size."""
    if min(grey.shape) < 2:
        return 0
    small = cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    dark = cv2.adaptiveThreshold(
        small, 1, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY_INV, _PIECES_WINDOW_PX, 7
    )
    boxes = cv2.connectedComponentsWithStats(dark, connectivity=4)[2]
    around = 2 * (boxes[1:, cv2.CC_STAT_WIDTH] + boxes[1:, cv2.CC_STAT_HEIGHT])
    return int(np.count_nonzero(around >= _LEAST_PERIMETER * max(small.shape)))


def square_to_quads(quads: Array) -> Array:
    """Homographies (n, 3, 3) from the unit square (0, 0), (1, 0), (1, 1), (0, 1) to the quads.

    Closed form: Heckbert, «Fundamentals of texture mapping and image warping» (1989), 2.2.3.
    """
    a, b, c, d = np.moveaxis(quads, 1, 0)
    bend, right, down = a - b + c - d, b - c, d - c
    determinant = right[:, 0] * down[:, 1] - right[:, 1] * down[:, 0]
    safe = np.where(np.abs(determinant) > 1e-9, determinant, 1e-9)
    g = (bend[:, 0] * down[:, 1] - bend[:, 1] * down[:, 0]) / safe
    h = (right[:, 0] * bend[:, 1] - right[:, 1] * bend[:, 0]) / safe
    maps = np.empty((len(quads), 3, 3))
    maps[:, :2, 0] = b - a + g[:, None] * b
    maps[:, :2, 1] = d - a + h[:, None] * d
    maps[:, :2, 2] = a
    maps[:, 2] = np.stack([g, h, np.ones_like(g)], axis=-1)
    return maps


def mapped(homographies: Array, points: Array) -> Array:
    """Points (m, 2), or (n, m, 2) for each its own, through n homographies (n, 3, 3): (n, m, 2).

    A point on the horizon comes out far away, never as no number.
    """
    turned = np.swapaxes(homographies, -1, -2)
    flat = points @ turned[:, :2] + turned[:, 2:]
    depth = flat[..., 2:]
    return flat[..., :2] / np.where(np.abs(depth) < 1e-9, 1e-9, depth)
