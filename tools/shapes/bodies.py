"""What carries the faces: a box, three vanes, or a single board.

All take a `plain` face, wherever it is, and number its copies from 0; heights are those of the
prints' middles above the floor, metres.
"""

import math
from collections.abc import Sequence
from enum import StrEnum

import numpy as np

from trigpoint.site.target import Face

from .upright import numbered, print_size, upright

VANE_AZIMUTHS_DEG = (90.0, 210.0, 330.0)
HALF_THICKNESS = 0.003
INNER_EDGE = 0.04  # of the pattern, from the axis
VANE_HEIGHT = 0.72  # of the paper's target


class Side(StrEnum):
    """A side of the robot, as the robot sees it."""

    FRONT = "front"
    LEFT = "left"
    BACK = "back"
    RIGHT = "right"

    @property
    def azimuth_rad(self) -> float:
        """Where it looks in the robot's base."""
        return list(Side).index(self) * math.pi / 2


def box_faces(
    plain: Face,
    sides: Sequence[Side],
    *,
    length: float,
    width: float,
    height: float,
    at: tuple[float, float] = (0.0, 0.0),
) -> tuple[Face, ...]:
    """One face in the middle of each of these sides of a box, looking outwards. `length` is along
    the robot, `width` across it; `at`: the box's middle, forward and left of the base."""
    faces = []
    for number, side in enumerate(sides):
        out = (length if side in (Side.FRONT, Side.BACK) else width) / 2
        forward, left = math.cos(side.azimuth_rad), math.sin(side.azimuth_rad)
        middle = np.array([at[0] + out * forward, at[1] + out * left, height])
        face = numbered(plain, number)
        faces.append(upright(face, azimuth_rad=side.azimuth_rad, middle=middle))
    return tuple(faces)


def vane_faces(
    plain: Face, *, height: float, at: tuple[float, float] = (0.0, 0.0)
) -> tuple[Face, ...]:
    """Six faces on three vanes about an upright axis: faces 2i and 2i + 1 are the sides of vane i,
    towards greater and smaller azimuth."""
    middle_m = INNER_EDGE + print_size(plain)[0] / 2
    faces = []
    for azimuth_rad in np.radians(VANE_AZIMUTHS_DEG).tolist():
        along = np.array([np.cos(azimuth_rad), np.sin(azimuth_rad), 0.0])
        for side in (1, -1):
            looks_rad = azimuth_rad + side * math.pi / 2
            out = np.array([np.cos(looks_rad), np.sin(looks_rad), 0.0])
            middle = np.array([*at, height]) + along * middle_m + out * HALF_THICKNESS
            face = numbered(plain, len(faces))
            faces.append(upright(face, azimuth_rad=looks_rad, middle=middle))
    return tuple(faces)
