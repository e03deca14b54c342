"""What is wrong with a target, and what its user should know."""

from itertools import combinations, product

import numpy as np
from msgspec import Struct

from trigpoint.base.errors import TargetError
from trigpoint.edge.registration.dictionaries import predefined_dictionary
from trigpoint.geometry.rotation import Array
from trigpoint.site.target import Face, Numbering, Pattern, Target

_TOUCH_M = 1e-4
_PARALLEL = 1e-6


class Findings(Struct, frozen=True):
    """`problems` must be fixed; `notes` describe how the target behaves."""

    problems: tuple[str, ...]
    notes: tuple[str, ...]


def check_target(target: Target) -> Findings:
    problems = [
        problem
        for face in target.faces
        for problem in (*_key_problems(face), *_marker_problems(face))
    ]
    problems += [
        f"faces {first.id} and {second.id} run through each other; "
        "correct a translation or a quaternion"
        for first, second in combinations(target.faces, 2)
        if intersects(first, second)
    ]
    return Findings(tuple(problems), tuple(_look_alikes(target) + _half_turns(target)))


def _key_problems(face: Face) -> list[str]:
    """Keys that this pattern does not have and that would have no effect."""
    of_grids = ("corner_squares", "tags_turned")
    foreign = {
        Pattern.CHECKERBOARD: ("legacy", "marker", "dictionary", *of_grids),
        Pattern.APRILGRID: ("legacy", "inverted"),
        Pattern.CHARUCO: of_grids,
    }[face.pattern]
    if face.pattern is not Pattern.APRILGRID and face.numbering is not Numbering.TOP_LEFT:
        foreign += ("numbering",)
    return [
        f"face {face.id}: {key} means nothing for {face.pattern.value}; remove it"
        for key in foreign
        if getattr(face, key) not in (None, False)
    ]


def _marker_problems(face: Face) -> list[str]:
    if face.pattern is Pattern.CHECKERBOARD:
        return []
    try:
        size = len(predefined_dictionary(face.dictionary or "").bytesList)
    except TargetError as reason:
        return [f"face {face.id}: {reason}"]
    last = face.first_marker + face.marker_count - 1
    if last >= size:
        return [
            f"face {face.id} needs markers {face.first_marker} to {last}, but {face.dictionary} "
            f"has {size}; lower first_marker or use a larger dictionary"
        ]
    return []


def _look_alikes(target: Target) -> list[str]:
    groups = {face.appearance: target.look_alikes(face.appearance) for face in target.faces}
    return [
        f"faces {_listed(group)} look alike: they are sighted as face -1, "
        "and the estimator works out which it was"
        for group in groups.values()
        if len(group) > 1
    ]


def _half_turns(target: Target) -> list[str]:
    turned = [face for face in target.faces if face.reads_from_both_ends]
    if not turned:
        return []
    verb = "face {} reads" if len(turned) == 1 else "faces {} read"
    return [
        f"{verb.format(_listed(turned))} the same from both ends (columns + rows is even); the "
        "estimator works out which way up it was; columns + rows odd would tell by itself"
    ]


def _listed(faces: list[Face] | tuple[Face, ...]) -> str:
    *most, last = [str(face.id) for face in faces]
    return f"{', '.join(most)} and {last}" if most else last


def intersects(first: Face, second: Face) -> bool:
    """Whether two faces' printed rectangles intersect in space, beyond touching: whether there is
    no axis along which they lie apart (the separating axis theorem)."""
    faces = [face.base_from_face @ face.outline for face in (first, second)]
    edges = [(corners[1] - corners[0], corners[3] - corners[0]) for corners in faces]
    normals = [face.base_from_face.rotation[:, 2] for face in (first, second)]
    if np.linalg.norm(np.cross(normals[0], normals[1])) > _PARALLEL:
        axes = [*normals, *(np.cross(a, b) for a, b in product(*edges))]
    elif abs(normals[0] @ (faces[1][0] - faces[0][0])) > _TOUCH_M:
        return False
    else:
        axes = [edge for each in edges for edge in each]
    axes = [axis for axis in axes if np.linalg.norm(axis) > _PARALLEL]
    return not any(_apart(faces[0], faces[1], axis) for axis in axes)


def _apart(first: Array, second: Array, axis: Array) -> bool:
    """Whether corners (n, 3) lie on either side of a plane across an axis, or touch it."""
    a, b = (corners @ axis / np.linalg.norm(axis) for corners in (first, second))
    return min(a.max() - b.min(), b.max() - a.min()) <= _TOUCH_M
