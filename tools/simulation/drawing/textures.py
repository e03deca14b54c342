"""What is printed on a face, in several resolutions."""

from functools import cache

import cv2
import numpy as np
from msgspec import Struct

from trigpoint.base.errors import InputError
from trigpoint.site.target import Face, Pattern
from trigpoint.tools.shapes.bodies import MARGIN_M

LEVELS = (96, 48, 32, 24, 16, 12, 8)  # texels a square; all divide the first, so edges stay exact
BLACK, WHITE = 28, 222
NOTHING = 2  # texels of no coverage around a sheet


class Texture(Struct, frozen=True, eq=False):
    """A sheet: `texels` (h, w, 2) uint8, grey times coverage, and coverage (0 or 255).

    The face point (x, y) lies at texel ((x, y) + square) · scale + offset; (0, 0) is a centre.
    """

    texels: np.ndarray
    scale: float
    offset: float
    square: float

    @property
    def matrix(self) -> np.ndarray:
        """Texels from face coordinates x, y, 1; (3, 3)."""
        shift = self.square * self.scale + self.offset
        return np.array([[self.scale, 0.0, shift], [0.0, self.scale, shift], [0.0, 0.0, 1.0]])


@cache
def texture(face: Face, texels: int) -> Texture:
    """A face's sheet at one of LEVELS, area-averaged from the finest."""
    size = (face.columns * texels, face.rows * texels)
    grey = cv2.resize(_printed(face), size, interpolation=cv2.INTER_AREA)
    margin = max(1, round(MARGIN_M / face.square * texels))
    grey = _framed(grey, margin, WHITE)
    sheet = np.dstack([_framed(grey, NOTHING, 0), _framed(np.full_like(grey, 255), NOTHING, 0)])
    return Texture(sheet, texels / face.square, margin + NOTHING - 0.5, face.square)


def level_for(square_px: float) -> int:
    """The level whose texels are about half a pixel where a square takes `square_px` pixels."""
    return min(LEVELS, key=lambda texels: abs(float(np.log(texels / (2 * square_px)))))


def _framed(picture: np.ndarray, width: int, value: int) -> np.ndarray:
    return cv2.copyMakeBorder(
        picture, width, width, width, width, cv2.BORDER_CONSTANT, value=(float(value),)
    )


@cache
def _printed(face: Face) -> np.ndarray:
    """The pattern at the finest level; its squares' edges lie exactly between texels."""
    if face.pattern is Pattern.CHECKERBOARD:
        row, column = np.indices((face.rows, face.columns))
        squares = ((row + column + face.inverted) % 2 * 255).astype(np.uint8)
        pattern = np.kron(squares, np.ones((LEVELS[0], LEVELS[0]), np.uint8))
    elif face.pattern is Pattern.CHARUCO:
        size = (face.columns * LEVELS[0], face.rows * LEVELS[0])
        pattern = charuco_board(face).generateImage(size)
    else:
        raise InputError(f"the simulation prints no {face.pattern.value} faces; use charuco")
    return np.where(pattern > 127, WHITE, BLACK).astype(np.uint8)


def charuco_board(face: Face) -> cv2.aruco.CharucoBoard:
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, str(face.dictionary)))
    ids = np.arange(face.first_marker, face.first_marker + face.marker_count, dtype=np.int32)
    size, marker = (face.columns, face.rows), float(face.marker or 0.0)
    board = cv2.aruco.CharucoBoard(size, face.square, marker, dictionary, ids)
    board.setLegacyPattern(face.legacy)
    return board
