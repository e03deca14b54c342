"""The targets that simulated robots carry: three upright vanes about the robot's z axis, a face on
either side of each, and target files for them."""

from functools import cache
from typing import Any

import numpy as np
from msgspec import structs

from trigpoint.geometry import Pose
from trigpoint.site.target import Face, Pattern, Target

VANE_AZIMUTHS_DEG = (90.0, 210.0, 330.0)
HALF_THICKNESS = 0.003
INNER_EDGE = 0.04  # of the pattern, from the axis
CENTRE_HEIGHT = 0.72
PANEL_MARGIN = 0.01  # white around the pattern


def star(name: str, plain: Face) -> Target:
    """Six faces like `plain` on three vanes, each with its own markers where it has markers.

    Faces 2i and 2i + 1 are the two sides of vane i.
    """
    sides = [(azimuth, side) for azimuth in np.radians(VANE_AZIMUTHS_DEG) for side in (1, -1)]
    faces = [
        structs.replace(
            plain,
            id=number,
            first_marker=number * plain.marker_count,
            **_place(azimuth, side, plain),
        )
        for number, (azimuth, side) in enumerate(sides)
    ]
    return Target(name, tuple(faces))


@cache
def target_of(choice: str) -> Target:
    """`checkerboard`: the paper's boards, all alike. `charuco`: larger squares, as a marker can be
    read only where it takes about 15 pixels."""
    here: dict[str, Any] = {
        "id": 0,
        "translation": (0.0, 0.0, 0.0),
        "quaternion": (0.0, 0.0, 0.0, 1.0),
    }
    if choice == "checkerboard":
        plain = Face(pattern=Pattern.CHECKERBOARD, columns=9, rows=7, square=0.0285, **here)
    else:
        plain = Face(
            pattern=Pattern.CHARUCO,
            columns=5,
            rows=4,
            square=0.06,
            marker=0.045,
            dictionary="DICT_4X4_250",
            **here,
        )
    return star("three-plane", plain)


def panel(face: Face) -> np.ndarray:
    """The four corners of the white sheet that carries a face's pattern, face frame, (4, 3)."""
    margin = PANEL_MARGIN * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    return face.outline + margin


def target_text(target: Target) -> str:
    """The target as a target file."""
    lines = [f'name = "{target.name}"']
    for face in target.faces:
        lines += ["", "[[faces]]", f"id = {face.id}", f'pattern = "{face.pattern.value}"']
        lines += [f"columns = {face.columns}", f"rows = {face.rows}", f"square = {face.square!r}"]
        if face.pattern is not Pattern.CHECKERBOARD:
            lines += [f"marker = {face.marker!r}", f'dictionary = "{face.dictionary}"']
            lines += [f"first_marker = {face.first_marker}"]
        lines += [
            f"translation = {list(face.translation)}",
            f"quaternion = {list(face.quaternion)}",
        ]
    return "\n".join(lines) + "\n"


def _place(azimuth: float, side: int, face: Face) -> dict[str, tuple[float, ...]]:
    """Translation and quaternion of a face on the side of its vane towards greater (1) or smaller
    (-1) azimuth, rounded as they are written."""
    outward = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    into_board = -side * np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    down = np.array([0.0, 0.0, -1.0])
    near, far = INNER_EDGE + face.square, INNER_EDGE + (face.columns - 1) * face.square
    corner = outward * (far if side == 1 else near) - into_board * HALF_THICKNESS
    corner[2] = CENTRE_HEIGHT + (face.rows - 2) / 2 * face.square
    pose = Pose(np.column_stack([np.cross(down, into_board), down, into_board]), corner)
    return {
        "translation": tuple(round(float(value), 9) for value in pose.translation),
        "quaternion": tuple(round(float(value), 12) for value in pose.quaternion),
    }
