"""The targets that robots carry in drawn sessions: patterns of every kind, on three shapes."""

from functools import cache

import numpy as np
from msgspec import structs

from trigpoint.geometry import Pose
from trigpoint.site.target import Face, Pattern, Target

_CENTRE_HEIGHT_M = 0.72
_HALF_THICKNESS_M = 0.003
_INNER_EDGE_M = 0.04  # from a vane's axis to its pattern
_BOX_MARGIN_M = 0.02

_NOWHERE = {"translation": (0.0, 0.0, 0.0), "quaternion": (0.0, 0.0, 0.0, 1.0)}


def _checkerboard(columns: int, rows: int, square: float) -> Face:
    pattern = Pattern.CHECKERBOARD
    return Face(id=0, pattern=pattern, columns=columns, rows=rows, square=square, **_NOWHERE)


def _marked(
    pattern: Pattern, columns: int, rows: int, square: float, marker: float, dictionary: str
) -> Face:
    return Face(
        id=0,
        pattern=pattern,
        columns=columns,
        rows=rows,
        square=square,
        marker=marker,
        dictionary=dictionary,
        **_NOWHERE,
    )


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
    "charuco": ((_marked(Pattern.CHARUCO, 9, 7, 0.0285, 0.021, "DICT_5X5_1000"),),) * 3,
    "charuco_large": ((_marked(Pattern.CHARUCO, 5, 4, 0.06, 0.045, "DICT_4X4_250"),),) * 3,
    "aprilgrid": ((_marked(Pattern.APRILGRID, 3, 2, 0.1, 0.078, "DICT_APRILTAG_36h11"),),) * 3,
}


@cache
def target_of(pattern: str, shape: str, *, variant: int = 0, name: str = "three-plane") -> Target:
    """A target; `variant` (0 to 2): another one of the same kind, which pictures tell apart."""
    places = _SHAPES[shape]
    prints = _PRINTS[pattern][variant]
    marker, faces = variant * len(places) * prints[0].marker_count, []
    for number, (azimuth_deg, facing_deg, is_beside) in enumerate(places):
        plain = prints[min(number, len(prints) - 1)]
        pose = _base_from_face(plain, azimuth_deg, facing_deg, is_beside=is_beside)
        faces.append(
            structs.replace(
                plain,
                id=number,
                first_marker=marker,
                translation=tuple(round(float(v), 9) for v in pose.translation),
                quaternion=tuple(round(float(v), 12) for v in pose.quaternion),
            )
        )
        marker += plain.marker_count
    return Target(name, tuple(faces))


def _vanes(azimuths_deg: tuple[float, ...]) -> list[tuple[float, float, bool]]:
    return [(a, a + side * 90.0, True) for a in azimuths_deg for side in (1, -1)]


# (azimuth of the face's middle, where it faces to, whether it lies beside the axis as a vane)
_SHAPES: dict[str, list[tuple[float, float, bool]]] = {
    "star": _vanes((90.0, 210.0, 330.0)),
    "box": [(azimuth, azimuth, False) for azimuth in (0.0, 90.0, 180.0, 270.0)],
    "sheet": _vanes((90.0,)),
}


def _base_from_face(face: Face, azimuth_deg: float, facing_deg: float, *, is_beside: bool) -> Pose:
    into_board, down = -_level(facing_deg), np.array([0.0, 0.0, -1.0])
    rotation = np.column_stack([np.cross(down, into_board), down, into_board])
    middle = face.outline.mean(axis=0)
    width = float(np.ptp(face.outline[:, 0]))
    away = _INNER_EDGE_M + width / 2 if is_beside else width / 2 + _BOX_MARGIN_M
    centre = away * _level(azimuth_deg) - _HALF_THICKNESS_M * into_board
    centre[2] = _CENTRE_HEIGHT_M
    return Pose(rotation, centre - rotation @ middle)


def _level(azimuth_deg: float) -> np.ndarray:
    azimuth = np.radians(azimuth_deg)
    return np.array([np.cos(azimuth), np.sin(azimuth), 0.0])


def mounted(target: Target, metres: float, radians: float, random: np.random.Generator) -> Target:
    """The target as it truly is, each face off by normal draws."""
    sigma = np.repeat([metres, radians], 3)
    faces = []
    for face in target.faces:
        pose = face.base_from_face.disturbed(random.standard_normal(6) * sigma)
        faces.append(
            structs.replace(
                face,
                translation=tuple(float(v) for v in pose.translation),
                quaternion=tuple(float(v) for v in pose.quaternion),
            )
        )
    return Target(target.name, tuple(faces))
