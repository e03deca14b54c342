"""What carries the faces: a box, three vanes, or a single board.

All take a `plain` face, wherever it is, and number its copies from 0; they hang upright, by the
middle of the print and the way that it looks. Heights are those of the middles above the floor,
metres.
"""

import math
from collections.abc import Sequence
from enum import StrEnum

import numpy as np
from msgspec import structs

from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.site.target import Face

VANE_AZIMUTHS_DEG = (90.0, 210.0, 330.0)
HALF_THICKNESS = 0.003
INNER_EDGE = 0.04  # of the pattern, from the axis
VANE_HEIGHT = 0.72  # of the paper's target
MARGIN_M = 0.01
"""White around a print: a finder needs the edge of the outermost squares."""


def upright(face: Face, *, azimuth_rad: float, middle: Array) -> Face:
    """The face with its top up, the middle of its print at `middle` ((3,), base, m), looking to an
    azimuth (0: ahead, +π/2: left); rounded as target files are written."""
    normal = np.array([np.cos(azimuth_rad), np.sin(azimuth_rad), 0.0])
    down = np.array([0.0, 0.0, -1.0])
    rotation = np.column_stack([np.cross(down, -normal), down, -normal])
    pose = Pose(rotation, middle - rotation @ face.outline.mean(axis=0))
    return structs.replace(
        face,
        translation=tuple(round(float(value), 9) + 0.0 for value in pose.translation),
        quaternion=tuple(round(float(value), 12) + 0.0 for value in pose.quaternion),
    )


def numbered(face: Face, number: int) -> Face:
    """The face as number `number` of several that are alike but for their markers."""
    first = face.first_marker + number * face.marker_count
    return structs.replace(face, id=number, first_marker=first)


def print_size(face: Face) -> tuple[float, float]:
    """Width and height of what is printed, metres."""
    width, height, _ = (face.outline.max(axis=0) - face.outline.min(axis=0)).tolist()
    return width, height


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
