"""The targets that simulated robots carry: three upright vanes about the robot's z axis, a face on
either side of each."""

from functools import cache

import numpy as np

from trigpoint.site.target import NOWHERE, Face, Pattern, Target
from trigpoint.tools.shapes.bodies import MARGIN_M, VANE_HEIGHT, vane_faces


@cache
def target_of(choice: str) -> Target:
    """`checkerboard`: the paper's boards, all alike. `charuco`: larger squares, as a marker can be
    read only where it takes about 15 pixels."""
    if choice == "checkerboard":
        plain = Face(0, Pattern.CHECKERBOARD, 9, 7, 0.0285, *NOWHERE)
    else:
        markers = {"marker": 0.045, "dictionary": "DICT_4X4_250"}
        plain = Face(0, Pattern.CHARUCO, 5, 4, 0.06, *NOWHERE, **markers)
    return Target("three-plane", vane_faces(plain, height=VANE_HEIGHT))


def panel(face: Face) -> np.ndarray:
    """The four corners of the white sheet that carries a face's pattern, face frame, (4, 3)."""
    margin = MARGIN_M * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    return face.outline + margin
