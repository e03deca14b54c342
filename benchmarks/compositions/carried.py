"""The targets that robots carry in drawn sessions: patterns of every kind, on three shapes."""

from functools import cache, partial
from typing import Any

import numpy as np
from msgspec import structs

from trigpoint.site.target import NOWHERE, Face, Pattern, Target
from trigpoint.tools.shapes.bodies import (
    HALF_THICKNESS,
    VANE_HEIGHT,
    Side,
    box_faces,
    print_size,
    vane_faces,
)

_BOX_MARGIN_M = 0.02


def face_of(
    pattern: Pattern,
    columns: int,
    rows: int,
    square: float,
    marker: float | None = None,
    dictionary: str | None = None,
    **more: Any,
) -> Face:
    """Such a face, wherever it is; `more`: other fields."""
    markers = {"marker": marker, "dictionary": dictionary}
    return Face(0, pattern, columns, rows, square, *NOWHERE, **markers, **more)


_checkerboard = partial(face_of, Pattern.CHECKERBOARD)

# Of each pattern: what each of a target's faces has printed on it (the last one for all further),
# for the first, second and third robot where they carry different ones. Checkerboards whose
# columns and rows add up to an even number read from either end.
_PRINTS: dict[str, tuple[tuple[Face, ...], ...]] = {
    "checkerboard": (
        (_checkerboard(9, 7, 0.0285),),
        (_checkerboard(8, 6, 0.033),),
        (_checkerboard(7, 5, 0.036),),
    ),
    "checkerboard_odd": (
        (_checkerboard(9, 6, 0.0285),),
        (_checkerboard(8, 5, 0.033),),
        (_checkerboard(8, 7, 0.03),),
    ),
    "checkerboards": (
        tuple(
            _checkerboard(*size, 0.03) for size in ((9, 7), (9, 6), (8, 7), (8, 6), (8, 5), (7, 5))
        ),
        tuple(
            _checkerboard(*size, 0.04) for size in ((6, 5), (6, 4), (5, 4), (7, 4), (7, 6), (5, 3))
        ),
        tuple(
            _checkerboard(*size, 0.03)
            for size in ((10, 7), (10, 6), (10, 8), (9, 5), (9, 8), (10, 5))
        ),
    ),
    "charuco": ((face_of(Pattern.CHARUCO, 9, 7, 0.0285, 0.021, "DICT_5X5_1000"),),) * 3,
    "charuco_large": ((face_of(Pattern.CHARUCO, 5, 4, 0.06, 0.045, "DICT_4X4_250"),),) * 3,
    "aprilgrid": ((face_of(Pattern.APRILGRID, 3, 2, 0.1, 0.078, "DICT_APRILTAG_36h11"),),) * 3,
}


@cache
def target_of(pattern: str, shape: str, *, variant: int = 0, name: str = "three-plane") -> Target:
    """A target; `variant` (0 to 2): another one of the same kind, which pictures tell apart."""
    hung, prints, faces = _SHAPES[shape], _PRINTS[pattern][variant], list[Face]()
    count = len(hung(prints[0]))
    for number in range(count):
        plain = prints[min(number, len(prints) - 1)]
        first = variant * count * plain.marker_count
        faces.append(hung(structs.replace(plain, first_marker=first))[number])
    return Target(name, tuple(faces))


def _star(plain: Face) -> tuple[Face, ...]:
    return vane_faces(plain, height=VANE_HEIGHT)


def _box(plain: Face) -> tuple[Face, ...]:
    side = print_size(plain)[0] + 2 * (_BOX_MARGIN_M + HALF_THICKNESS)
    return box_faces(plain, list(Side), length=side, width=side, height=VANE_HEIGHT)


def _sheet(plain: Face) -> tuple[Face, ...]:
    return _star(plain)[:2]


_SHAPES = {"star": _star, "box": _box, "sheet": _sheet}


def mounted(target: Target, metres: float, radians: float, random: np.random.Generator) -> Target:
    """The target as it truly is, each face off by normal draws."""
    sigma = np.repeat([metres, radians], 3)
    faces = (_moved(face, random.standard_normal(6) * sigma) for face in target.faces)
    return Target(target.name, tuple(faces))


def _moved(face: Face, by: np.ndarray) -> Face:
    pose = face.base_from_face.disturbed(by)
    return structs.replace(
        face,
        translation=tuple(float(value) for value in pose.translation),
        quaternion=tuple(float(value) for value in pose.quaternion),
    )
