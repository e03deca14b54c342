"""Whether what is seen of a board tells how its markers are laid out.

The layouts that people mistake for each other (legacy, columns and rows exchanged, Kalibr's
numbering) have the same markers beside each other in parts: a row by itself is in all of them, and
a legacy ChArUco board with an odd number of columns is, but for one column, the other one moved by
a square. Such a part, by itself, is no proof of the file.
"""

from functools import cache

import numpy as np

from trigpoint.geometry.rotation import Array
from trigpoint.site.target import Face

from .other_boards import changed, changes_of_places, toml
from .other_sizes import layout_of


def as_well(face: Face, numbers: np.ndarray) -> str:
    """Another layout in which the markers `numbers` (k,) lie to each other as in the face's own,
    as the target file has it; empty where there is none."""
    for change, steps in _moves(face):
        if np.all(steps[numbers] == steps[numbers[0]]):
            return change
    return ""


@cache
def _moves(face: Face) -> tuple[tuple[str, Array], ...]:
    """Each other layout, and by how many squares it has each marker elsewhere, (m, 2)."""
    own, found = layout_of(face).mean(axis=1), []
    for change in changes_of_places(face):
        other = changed(face, change)
        if other is None:
            continue
        steps = np.rint((layout_of(other).mean(axis=1) - own) / face.square)
        if np.any(steps != steps[0]):
            found.append((" and ".join(f"{key} = {toml(v)}" for key, v in change.items()), steps))
    return tuple(found)
