"""The targets that simulated robots carry: three upright vanes about the robot's z axis, a face on
either side of each."""

from functools import cache
from typing import Any

import numpy as np

from trigpoint.site.target import Face, Pattern, Target
from trigpoint.tools.shapes.bodies import VANE_HEIGHT, vane_faces
from trigpoint.tools.shapes.upright import MARGIN_M


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
    return Target("three-plane", vane_faces(plain, height=VANE_HEIGHT))


def panel(face: Face) -> np.ndarray:
    """The four corners of the white sheet that carries a face's pattern, face frame, (4, 3)."""
    margin = MARGIN_M * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    return face.outline + margin
