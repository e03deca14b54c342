"""The targets that simulated robots carry: three upright vanes about the robot's z axis, a face on
either side of each, and target files for them."""

import numpy as np

from trigpoint.geometry import Pose
from trigpoint.target import Face, Pattern, Target

VANE_AZIMUTHS_DEG = (90.0, 210.0, 330.0)
HALF_THICKNESS = 0.003
INNER_EDGE = 0.04  # of the pattern, from the axis
CENTRE_HEIGHT = 0.62
PANEL_MARGIN = 0.01  # white around the pattern


def star(
    name: str, pattern: Pattern, columns: int, rows: int, square: float, **marks: object
) -> Target:
    """Six faces on three vanes. Faces 2i and 2i + 1 are the two sides of vane i."""
    faces = []
    for azimuth in np.radians(VANE_AZIMUTHS_DEG):
        for side in (1, -1):
            pose = _base_from_face(azimuth, side, columns, rows, square)
            face = _face(len(faces), pattern, columns, rows, square, pose, marks)
            faces.append(face)
    return Target(name, tuple(faces))


def target_of(choice: str) -> Target:
    """`checkerboard`: the paper's boards, all alike. `charuco`: larger squares, as a marker takes
    about 16 pixels of a side to be read."""
    if choice == "checkerboard":
        return star("three-plane", Pattern.CHECKERBOARD, 9, 7, 0.0285)
    marks = {"marker": 0.047, "dictionary": "DICT_4X4_250"}
    return star("three-plane", Pattern.CHARUCO, 5, 4, 0.06, **marks)


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


def _base_from_face(azimuth: float, side: int, columns: int, rows: int, square: float) -> Pose:
    """A face on the side of its vane that lies towards greater (1) or smaller (-1) azimuth."""
    outward = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    into_board = -side * np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    down = np.array([0.0, 0.0, -1.0])
    right = np.cross(down, into_board)
    near, far = INNER_EDGE + square, INNER_EDGE + (columns - 1) * square
    height = CENTRE_HEIGHT + (rows - 2) / 2 * square
    corner = outward * (far if side == 1 else near) - into_board * HALF_THICKNESS
    corner[2] = height
    return Pose(np.column_stack([right, down, into_board]), corner)


def _face(
    number: int,
    pattern: Pattern,
    columns: int,
    rows: int,
    square: float,
    pose: Pose,
    marks: dict[str, object],
) -> Face:
    x, y, z = (round(float(value), 9) for value in pose.translation)
    i, j, k, w = (round(float(value), 12) for value in pose.quaternion)
    first = number * (columns * rows // 2) if marks else 0
    return Face(
        number, pattern, columns, rows, square, (x, y, z), (i, j, k, w), first_marker=first, **marks
    )  # pyright: ignore[reportArgumentType] - the marks are a face's own keys
