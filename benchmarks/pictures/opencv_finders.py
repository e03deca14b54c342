"""OpenCV's own finders of boards, set up as its users set them up."""

from collections.abc import Sequence

import cv2
import numpy as np

from trigpoint.contract.messages import FaceSighting
from trigpoint.site.target import Face
from trigpoint.tools.simulation.drawing.textures import charuco_board
from trigpoint.tools.simulation.sight.seen_corners import smallest_square

from .scoring import Finder, found_as

DEFAULTS = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
_STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.01)
# cornerSubPix's half window, of a square's side in the picture: it must not reach the next corner.
_WINDOW_SHARE = 0.4


def charuco_each(faces: Sequence[Face]) -> Finder:
    """A CharucoDetector for every face's board; each searches the picture for markers."""
    boards = [(face.id, cv2.aruco.CharucoDetector(charuco_board(face))) for face in faces]

    def find(picture: np.ndarray) -> list[FaceSighting]:
        answers = [(number, board.detectBoard(picture)) for number, board in boards]
        return [found for n, answer in answers for found in _charuco_found(n, *answer[:2])]

    return find


def charuco_shared(faces: Sequence[Face]) -> Finder:
    """One search for markers, whose result is handed to every face's CharucoDetector."""
    markers = cv2.aruco.ArucoDetector(charuco_board(faces[0]).getDictionary())
    boards = [(face, cv2.aruco.CharucoDetector(charuco_board(face))) for face in faces]

    def find(picture: np.ndarray) -> list[FaceSighting]:
        corners, ids, _ = markers.detectMarkers(picture)
        if ids is None:
            return []
        numbers, found = ids.reshape(-1), list[FaceSighting]()
        for face, board in boards:
            last = face.first_marker + face.marker_count
            mine = np.flatnonzero((numbers >= face.first_marker) & (numbers < last)).tolist()
            if mine:
                seen = [corners[i] for i in mine]
                answer = board.detectBoard(
                    picture, markerCorners=seen, markerIds=numbers[mine].astype(np.int32)
                )
                found += _charuco_found(face.id, *answer[:2])
        return found

    return find


def checkerboards(faces: Sequence[Face], flags: int = DEFAULTS) -> Finder:
    """The classic finder and cornerSubPix, until it finds no further face; with flags=0 without
    adaptive thresholds, for pictures whose light is even.

    With CALIB_CB_FAST_CHECK it took a third of the time here, but found one face in six.
    """
    size = (faces[0].columns - 1, faces[0].rows - 1)

    def find(picture: np.ndarray) -> list[FaceSighting]:
        left, found = picture.copy(), []
        while len(found) < len(faces):
            is_found, corners = cv2.findChessboardCorners(left, size, flags=flags)
            if not is_found:
                break
            pixels = corners.reshape(-1, 2)
            found.append(found_as(-1, np.arange(len(pixels)), _refined(picture, pixels, faces[0])))
            hull = cv2.convexHull(pixels.round().astype(np.int32))
            cv2.fillConvexPoly(left, hull, float(picture.mean()))
        return found

    return find


def checkerboards_by_sectors(faces: Sequence[Face]) -> Finder:
    """The sector finder at its most thorough, once."""
    size = (faces[0].columns - 1, faces[0].rows - 1)
    flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY

    def find(picture: np.ndarray) -> list[FaceSighting]:
        is_found, corners = cv2.findChessboardCornersSB(picture, size, flags=flags)
        if not is_found:
            return []
        pixels = np.asarray(corners).reshape(-1, 2)
        return [found_as(-1, np.arange(len(pixels)), pixels)]

    return find


def _charuco_found(
    face: int, corners: np.ndarray | None, ids: np.ndarray | None
) -> list[FaceSighting]:
    if corners is None or ids is None or len(ids) == 0:
        return []
    return [found_as(face, np.asarray(ids).reshape(-1), np.asarray(corners).reshape(-1, 2))]


def _refined(picture: np.ndarray, pixels: np.ndarray, face: Face) -> np.ndarray:
    half = max(2, int(_WINDOW_SHARE * smallest_square(face, pixels)))
    start = np.ascontiguousarray(pixels, np.float32).copy()
    return cv2.cornerSubPix(picture, start, (half, half), (-1, -1), _STOP).reshape(-1, 2)
