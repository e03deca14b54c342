"""What a face's pattern is: in words, and its black parts as rectangles in the face frame.

Rectangles are (n, 4): x, y, width, height, metres, y down the page; none lies over another.
"""

import cv2
import numpy as np

from trigpoint.edge.registration.dictionaries import predefined_dictionary
from trigpoint.edge.registration.printed_pattern import charuco_layout
from trigpoint.geometry.rotation import Array
from trigpoint.site.target import Face, Numbering, Pattern


def black_rectangles(face: Face) -> Array:
    """The pattern of a face; raises TargetError for an unknown dictionary."""
    match face.pattern:
        case Pattern.CHECKERBOARD:
            return _checkerboard(face)
        case Pattern.CHARUCO:
            return _charuco(face)
        case Pattern.APRILGRID:
            return _aprilgrid(face)


def _aprilgrid(face: Face) -> Array:
    tags = face.corners[:, :2].reshape(-1, 4, 2)
    cells = [_cells(face, number, tag) for number, tag in enumerate(tags)]
    return np.concatenate([*cells, _sized(*corner_squares(face))])


def corner_squares(face: Face) -> tuple[Array, float]:
    """The lower corners (n, 2) of the squares at an AprilGrid's tags, and their side."""
    gap = face.square - (face.marker or 0.0)
    if not face.has_corner_squares:
        return np.zeros((0, 2)), gap
    column, row = np.meshgrid(np.arange(face.columns + 1), np.arange(face.rows + 1))
    places = np.stack([column, row], axis=-1).reshape(-1, 2) * face.square
    return places + face.outline[0, :2], gap


def _charuco(face: Face) -> Array:
    """An inverted board has light and dark exchanged, so its marker squares are dark."""
    markers = charuco_layout(face)
    cells = [_cells(face, number, marker) for number, marker in enumerate(markers)]
    squares, holds = _squares(face), _holding(face, markers.mean(axis=1))
    if face.inverted:
        frames = [_frame(face, square) for square in squares[holds]]
        return np.concatenate([*frames, *cells])
    return np.concatenate([_sized(squares[~holds], face.square), *cells])


def _squares(face: Face) -> Array:
    """The lower corner of every square, row by row, (rows · columns, 2); corner 0 is (0, 0)."""
    column, row = np.meshgrid(np.arange(face.columns) - 1, np.arange(face.rows) - 1)
    return np.stack([column, row], axis=-1).reshape(-1, 2) * face.square


def described(face: Face) -> str:
    square_mm = face.square * 1000
    if face.pattern is Pattern.CHECKERBOARD:
        colours = ", inverted" if face.inverted else ""
        size = f"{face.columns} x {face.rows} squares of {square_mm:.2f} mm"
        return f"checkerboard, {size}{colours}"
    last = face.first_marker + face.marker_count - 1
    marks = f"{face.dictionary} {face.first_marker} to {last}, {(face.marker or 0) * 1000:.2f} mm"
    unit = "squares of" if face.pattern is Pattern.CHARUCO else "tags, pitch"
    kinds = [name for name in ("legacy", "inverted") if getattr(face, name)]
    kinds += ["tags counted from the bottom left"] if face.numbering is Numbering.KALIBR else []
    size = f"{face.columns} x {face.rows} {unit} {square_mm:.2f} mm"
    return ", ".join([f"{face.pattern.value}, {size}", marks, *kinds])


def _checkerboard(face: Face) -> Array:
    squares = _squares(face)
    is_even = np.rint(squares.sum(axis=1) / face.square).astype(int) % 2 == 0
    return _sized(squares[is_even != face.inverted], face.square)


def _holding(face: Face, centres: Array) -> np.ndarray:
    """Which of the squares hold a marker, (rows · columns,) bool."""
    offset = np.abs(_squares(face)[:, None] + face.square / 2 - centres[None])
    return np.any(np.all(offset < face.square / 4, axis=-1), axis=1)


def _frame(face: Face, corner: Array) -> Array:
    """A square's margins around its marker: above, below, left and right."""
    square, marker = face.square, face.marker or 0.0
    edge = (square - marker) / 2
    return np.array(
        [
            [0, 0, square, edge],
            [0, square - edge, square, edge],
            [0, edge, edge, marker],
            [square - edge, edge, edge, marker],
        ]
    ) + np.array([*corner, 0, 0])


def _cells(face: Face, number: int, quad: Array) -> Array:
    """The black cells of a marker; adjacent ones in a row form one rectangle."""
    dictionary = predefined_dictionary(face.dictionary or "")
    side = dictionary.markerSize + 2 * face.border_bits
    marker = face.first_marker + number
    bits = cv2.aruco.generateImageMarker(dictionary, marker, side, borderBits=face.border_bits)
    if face.has_turned_tags:
        bits = np.rot90(bits, 2)
    cell = (face.marker or 0.0) / side
    found = []
    for row, line in enumerate((bits == 0) != face.inverted):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], line.astype(int), [0]])))
        for start, end in edges.reshape(-1, 2):
            found.append([start * cell, row * cell, (end - start) * cell, cell])
    return np.array(found).reshape(-1, 4) + np.array([*quad[0], 0, 0])


def _sized(corners: Array, side: float) -> Array:
    return np.column_stack([corners, np.full((len(corners), 2), side)])
