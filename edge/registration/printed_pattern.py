"""What is printed on a face, as a picture in the face's own coordinates."""

from functools import cache

import cv2
import numpy as np
from msgspec import Struct

from trigpoint.geometry.rotation import Array
from trigpoint.site.target import Face, Pattern

from .dictionaries import dictionary_of

# Texels a square; the edges of squares lie between texels at every level.
LEVELS = (12, 24, 48)
_MOST_TEXELS = 6_000_000
_MARGIN_SQUARES = 1
_LIGHT = 255


class PrintedPattern(Struct, frozen=True, eq=False):
    """A face as it is printed. `texels`: (h, w) uint8, 0 dark and 255 light; the face point (x, y)
    lies at texel (x, y) · `scale` + `offset` (2,), where whole numbers are texels'
    centres."""

    texels: np.ndarray
    scale: float
    offset: Array


def squares_are_light(face: Face, column: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Whether the squares of a ChArUco board in these columns and rows (n,) are light, (n,)."""
    return (column + row + (face.legacy and face.rows % 2 == 0)) % 2 == 1


@cache
def charuco_layout(face: Face) -> Array:
    """The markers' corners in the face frame by number, (m, 4, 2), metres; not to be written to.

    In the light squares, row by row, as OpenCV's CharucoBoard has them; before its version 4.6 a
    board with an even number of rows began with one (legacy).
    """
    y, x = np.indices((face.rows, face.columns)).reshape(2, -1)
    is_light = squares_are_light(face, x, y)
    marker = face.marker or 0.0
    # Corner 0 is a square away from the board's own corner.
    first = np.stack([x, y], axis=-1)[is_light] * face.square - (face.square + marker) / 2
    layout = first[:, None] + marker * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    layout.flags.writeable = False
    return layout


@cache
def printed_patterns(face: Face) -> tuple[PrintedPattern, ...]:
    """The pattern at every level; inverted boards as they are in the picture's negative."""
    if face.pattern is Pattern.APRILGRID:
        levels = [_fitting_tags(level, face) for level in LEVELS]
        printed = [_printed(face, level) for level in levels]
    else:
        levels, printed = LEVELS, _averaged(face)
    return tuple(
        PrintedPattern(texels, level / face.square, -_first_square(face) * level - 0.5)
        for level, texels in zip(levels, printed, strict=True)
    )


def _averaged(face: Face) -> list[np.ndarray]:
    """The pattern at every level, out of the finest one that is small enough."""
    finest = 2 * LEVELS[-1]
    columns, rows = (count + 2 * _MARGIN_SQUARES for count in (face.columns, face.rows))
    while columns * rows * finest**2 > _MOST_TEXELS and finest > LEVELS[-1]:
        finest //= 2
    printed = _printed(face, finest)
    return [
        cv2.resize(printed, (columns * level, rows * level), interpolation=cv2.INTER_AREA)
        for level in LEVELS
    ]


def _fitting_tags(level: int, face: Face) -> int:
    """Texels a square, about `level`, such that tags' edges lie between texels as nearly as may be.

    A texel that an edge runs through is grey, and the edge that is read between its neighbours lies
    elsewhere: by 0.2 px in tags of 88 px.
    """
    counts = np.arange(level, level + level // 3 + 1)
    texels = counts * (face.marker or 0.0) / face.square
    return int(counts[np.argmin(np.round(np.abs(texels - np.rint(texels)), 6))])


def _first_square(face: Face) -> Array:
    """Where the pattern with its margin begins, (2,), in squares from corner 0."""
    first = np.rint(face.corners.min(axis=0)[:2] / face.square)
    before = 0 if face.pattern is Pattern.APRILGRID else 1
    return first - before - _MARGIN_SQUARES


def _printed(face: Face, level: int) -> np.ndarray:
    """The pattern and a light margin, `level` texels a square."""
    x, y = (
        (np.arange((count + 2 * _MARGIN_SQUARES) * level) + 0.5) / level + low
        for count, low in zip((face.columns, face.rows), _first_square(face), strict=True)
    )
    texels = np.full((len(y), len(x)), _LIGHT, np.uint8)
    if face.pattern is Pattern.APRILGRID:
        layout = face.corners[:, :2].reshape(-1, 4, 2)
        _draw_corner_squares(texels, face, layout / face.square, x, y)
    else:
        layout = charuco_layout(face) if face.pattern is Pattern.CHARUCO else np.zeros((0, 4, 2))
        _draw_squares(texels, face, layout.mean(axis=1) / face.square, x, y)
    for number, quad in enumerate(layout / face.square):
        _draw_marker(texels, face, number, quad, x, y)
    return texels


def _draw_corner_squares(texels: np.ndarray, face: Face, tags: Array, x: Array, y: Array) -> None:
    """The squares that touch an AprilGrid's tags (n, 4, 2), where it has them; lengths in
    squares."""
    if not face.corner_squares:
        return
    gap = 1 - (face.marker or 0.0) / face.square
    across, down = (
        _overlaps(values, np.unique(np.rint(tags[:, 0, axis] * 2) / 2), gap)
        for axis, values in ((0, x), (1, y))
    )
    texels[:] = np.rint(_LIGHT * (1 - down[:, None] * across[None]))


def _overlaps(values: Array, tags: Array, gap: float) -> Array:
    """How much of each texel (n,) the gaps before, between and after tags cover that begin at
    `tags` (m,), a square apart: (n,)."""
    begins = np.append(tags, tags[-1] + 1) - gap
    return sum((_overlap(values, low, gap, 1)[:, 0] for low in begins), np.zeros(len(values)))


def _draw_squares(texels: np.ndarray, face: Face, markers: Array, x: Array, y: Array) -> None:
    """Every other square dark, and none that holds a marker; lengths in squares."""
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)
    light = np.floor(markers[0]).astype(int).sum() % 2 if len(markers) else 1
    dark = (row % 2 == 1)[:, None] ^ (column % 2 != light)[None]
    dark[(row < -1) | (row >= face.rows - 1)] = False
    dark[:, (column < -1) | (column >= face.columns - 1)] = False
    np.copyto(texels, 0, where=dark)


def _draw_marker(
    texels: np.ndarray, face: Face, number: int, quad: Array, x: Array, y: Array
) -> None:
    """The cells of one marker; lengths in squares."""
    dictionary = dictionary_of(face)
    side = dictionary.markerSize + 2 * face.border_bits
    marker = face.first_marker + number
    cells = cv2.aruco.generateImageMarker(dictionary, marker, side, borderBits=face.border_bits)
    if face.has_turned_tags:
        cells = np.rot90(cells, 2)
    cell = (face.marker or face.square) / face.square / side
    across, down = (
        _overlap(values, low, cell, side) for values, low in ((x, quad[0, 0]), (y, quad[0, 1]))
    )
    on_x, on_y = (np.flatnonzero(overlap.any(axis=1)) for overlap in (across, down))
    across, down = across[on_x], down[on_y]
    place = np.ix_(on_y, on_x)
    around = 1 - down.sum(axis=1)[:, None] * across.sum(axis=1)
    shade = around * texels[place] + down @ cells.astype(float) @ across.T
    texels[place] = np.rint(shade).astype(np.uint8)


def _overlap(values: Array, low: float, cell: float, count: int) -> Array:
    """How much of each texel, centred at `values` (n,), each of `count` cells covers: (n, count).

    Cells follow each other from `low` on. Their edges lie anywhere between texels; to move them to
    the nearest one would move the corners that are measured by them.
    """
    texel = values[1] - values[0]
    edges = low + cell * np.arange(count + 1)
    covered = np.clip((edges - values[:, None]) / texel + 0.5, 0.0, 1.0)
    return covered[:, 1:] - covered[:, :-1]
