"""Kalibr's black squares between the tags of an AprilGrid: are they there, and what that tells.

Where they are, every tag's corner is an X of two dark and two light sectors, all of them known, so
that all around it counts and ink that runs moves nothing.
"""

import numpy as np

from trigpoint.edge.image.median import median
from trigpoint.edge.image.sampling import sampled
from trigpoint.edge.image.time_limit import IsOver
from trigpoint.edge.registration.dictionaries import dictionary_of
from trigpoint.edge.registration.measurement import Measured, measured
from trigpoint.edge.registration.planar_fit import PlanarFit
from trigpoint.geometry.rotation import Array
from trigpoint.site.target import Face

from .marked_board import MarkedBoard


def refined(
    grey: np.ndarray, board: MarkedBoard, found: Measured, is_over: IsOver
) -> tuple[MarkedBoard, Measured]:
    """A board as the picture shows it: with corner squares known where they are seen."""
    if board.finer is None or is_over() or not shows_corner_squares(grey, board.face, found.fit):
        return board, found
    again = measured(grey, board.finer.pattern, found.fit, blur=found.blur)
    if again is None or len(again.corners) < len(found.corners):
        return board, found
    return board.finer, again


def shows_corner_squares(grey: np.ndarray, face: Face, fit: PlanarFit) -> bool:
    """Whether an AprilGrid that lies where `fit` has it has black squares at its tags' corners:
    whether those places are as dark as the tags' borders or as light as what lies between tags."""
    marker = face.marker or 0.0
    gap = face.square - marker
    cells = dictionary_of(face).markerSize + 2 * face.border_bits
    border = 0.5 * face.border_bits * marker / cells
    tags = face.corners[:, :2].reshape(-1, 4, 2)[:, 0]
    square, light, dark = (
        _usual(grey, fit, tags + offset)
        for offset in ([-gap / 2, -gap / 2], [marker / 2, -gap / 2], [border, border])
    )
    return square < (light + dark) / 2


def _usual(grey: np.ndarray, fit: PlanarFit, points: Array) -> float:
    """The median grey value at points (n, 2) of a face; those outside the picture do not count."""
    pixels = fit.project(points)
    inside = np.all((pixels >= 0) & (pixels <= np.array(grey.shape[::-1]) - 1), axis=1)
    return median(sampled(grey, pixels[inside])) if inside.any() else np.nan
