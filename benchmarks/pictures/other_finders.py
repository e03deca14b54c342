"""Finders of other libraries than OpenCV: calib-targets for boards, AprilTag's own for its tags.

They come with the extra `bench`; each is asked in its fastest fair form.
"""

from collections.abc import Iterable

import numpy as np
from apriltag import apriltag  # pyright: ignore[reportMissingImports]
from calib_targets import (  # pyright: ignore[reportMissingImports]
    CharucoBoardSpec,
    CharucoParams,
    ChessboardParams,
    MarkerLayout,
    ScanDecodeConfig,
    detect_charuco,
    detect_chessboard,
)

from trigpoint.site.target import Face

from .opencv_finders import Finder
from .scoring import Found


def chessboard_by_calib_targets(face: Face) -> Finder:
    """Its first chessboard; it is not told how many squares there are."""
    params = ChessboardParams(max_components=1)

    def find(picture: np.ndarray) -> list[Found]:
        board = detect_chessboard(_shown(picture, face), params=params)
        return _found(face, (corner.position for corner in board.corners) if board else ())

    return find


def charuco_by_calib_targets(face: Face) -> Finder:
    """Its ChArUco search."""
    share = (face.marker or 0.0) / face.square
    board = CharucoBoardSpec(
        rows=face.rows,
        cols=face.columns,
        cell_size=face.square,
        marker_size_rel=share,
        dictionary=face.dictionary,
        marker_layout=MarkerLayout.OPENCV_CHARUCO,
    )
    params = CharucoParams(board, scan=ScanDecodeConfig(marker_size_rel=share))

    def find(picture: np.ndarray) -> list[Found]:
        try:
            seen = detect_charuco(_shown(picture, face), params=params)
        except RuntimeError:  # that is how it says that there is none
            return []
        return _found(face, (corner.position for corner in seen.corners))

    return find


def tags_by_apriltag(face: Face) -> Finder:
    """Tags of the family 36h11 by AprilTag 3, which looks for edges at half the size, as it does
    where nothing else is said."""
    detector = apriltag("tag36h11", decimate=2.0)

    def find(picture: np.ndarray) -> list[Found]:
        tags = detector.detect(picture)
        return _found(face, (corner for tag in tags for corner in tag["lb-rb-rt-lt"]))

    return find


def _shown(picture: np.ndarray, face: Face) -> np.ndarray:
    return 255 - picture if face.inverted else picture


def _found(face: Face, pixels: Iterable[object]) -> list[Found]:
    seen = np.array(list(pixels), float).reshape(-1, 2)
    return [Found(face.id, np.arange(len(seen)), seen)] if len(seen) else []
