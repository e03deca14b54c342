"""What a face has around its corners, as it is printed; for the core to measure them by."""

from functools import cache

import numpy as np
from msgspec import Struct

from trigpoint.geometry.rotation import Array
from trigpoint.native.library import Handle, In, Kernel
from trigpoint.site.target import Face, Pattern

from .printed_pattern import printed_patterns


class Print(Handle):
    """What a face has around its corners, in the core."""

    name = "tp_pattern"


_POINTS = In(np.float64, ("n", 2))
_SET = Kernel("tp_pattern_set", Print, _POINTS, _POINTS, float, float)
_PRINT = Kernel("tp_pattern_print", Print, In(np.uint8, ("h", "w")), float, float, float)


class CornerPattern(Struct, frozen=True, eq=False):
    """What a face has around its corners. `points`: (n, 2) corners in the face frame; `reach`: how
    far from a corner along both axes is looked at, metres; `outward`: (n, 2) signs of the axes'
    directions of a sector that may be printed or not (Kalibr has squares there), 0 without one;
    `outline`: (4, 2) the pattern's outer corners in the face frame; `core`: all this with its
    prints, for the core."""

    face: Face
    points: Array
    reach: float
    outward: Array
    outline: Array
    core: Print

    @classmethod
    @cache
    def of(cls, face: Face) -> "CornerPattern":
        """The pattern of any face."""
        points = np.ascontiguousarray(face.corners[:, :2])
        outward = np.zeros_like(points)
        reach = 0.5 * face.square
        if face.pattern is Pattern.APRILGRID:
            if not face.corner_squares:
                outward = np.tile(
                    [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]], (len(points) // 4, 1)
                )
            reach = min(0.5 * (face.marker or 0.0), face.square - (face.marker or 0.0))
        outline = np.ascontiguousarray(face.outline[:, :2])
        return cls(face, points, reach, outward, outline, _core(face, points, outward, reach))


def _core(face: Face, points: Array, outward: Array, reach: float) -> Print:
    """The same for the core, with what is printed at every level."""
    pattern = Print()
    _SET(pattern, points, outward, reach, face.square)
    for printed in printed_patterns(face):
        _PRINT(pattern, printed.texels, printed.scale, *printed.offset.tolist())
    return pattern
