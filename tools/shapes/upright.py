"""Faces that stand upright on a robot, as they are hung: by the middle of the print and the way
that it looks."""

import numpy as np
from msgspec import structs

from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.site.target import Face

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
