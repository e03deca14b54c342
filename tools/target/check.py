"""What is wrong with a target, and what its user should know."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from trigpoint.base.errors import TargetError
from trigpoint.edge.registration.dictionaries import predefined_dictionary
from trigpoint.geometry.rotation import Array
from trigpoint.site.target import Face, Numbering, Pattern, Target

_TOUCH_M = 1e-4
_PARALLEL = 1e-6


@dataclass(frozen=True, slots=True)
class Findings:
    """`problems` must be fixed; `notes` describe how the target behaves."""

    problems: tuple[str, ...]
    notes: tuple[str, ...]


def check_target(target: Target) -> Findings:
    """Check every face and every pair of faces."""
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
    """Whether two faces' printed rectangles intersect in space, beyond touching."""
    a, b = (face.base_from_face @ face.outline for face in (first, second))
    normal_a, normal_b = (face.base_from_face.rotation[:, 2] for face in (first, second))
    across = np.cross(normal_a, normal_b)
    if np.linalg.norm(across) > _PARALLEL:
        return _meet_on_line(a, b, normal_a, normal_b, across / np.linalg.norm(across))
    if abs(normal_a @ (b[0] - a[0])) > _TOUCH_M:
        return False
    return _overlap_in_plane(a, b)


def _meet_on_line(a: Array, b: Array, normal_a: Array, normal_b: Array, line: Array) -> bool:
    """Rectangles in different planes intersect if they overlap on the planes' common line."""
    spans = [_span(a, b[0], normal_b, line), _span(b, a[0], normal_a, line)]
    if any(span is None for span in spans):
        return False
    (low_a, high_a), (low_b, high_b) = (span for span in spans if span is not None)
    return min(high_a, high_b) - max(low_a, low_b) > _TOUCH_M


def _span(corners: Array, origin: Array, normal: Array, line: Array) -> tuple[float, float] | None:
    """Interval along `line` where a rectangle (4, 3) cuts a plane; None if on one side of it."""
    height = (corners - origin) @ normal
    along = []
    for i in range(4):
        j = (i + 1) % 4
        if (height[i] > _TOUCH_M and height[j] < -_TOUCH_M) or (
            height[i] < -_TOUCH_M and height[j] > _TOUCH_M
        ):
            part = height[i] / (height[i] - height[j])
            along.append(float((corners[i] + part * (corners[j] - corners[i])) @ line))
    return (min(along), max(along)) if len(along) == 2 else None


def _overlap_in_plane(a: Array, b: Array) -> bool:
    """Two rectangles in one plane overlap if no side of either separates them."""
    for corners in (a, b):
        for axis in (corners[1] - corners[0], corners[3] - corners[0]):
            unit = axis / np.linalg.norm(axis)
            first, second = a @ unit, b @ unit
            if min(first.max(), second.max()) - max(first.min(), second.min()) <= _TOUCH_M:
                return False
    return True
