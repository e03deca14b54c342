"""A target as an opaque solid: where its corners are, and which of them are visible from where.

A face shows its pattern on its front alone, and no corner is visible through another face. So a
reading that would need either is impossible, however well its corners fit: the core decides that
(`reading.cpp`).
"""

from functools import cache, lru_cache

import numpy as np
from msgspec import Struct

from trigpoint.fusion.model.observations import Reading, View, base_from_faces
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.site.target import Target

from .views import body_tables


class Body(Struct, frozen=True, eq=False):
    """A target in the robot's base frame. `table` (f, c, 3): the faces' corners by id, padded to
    one size, with how many a face has in `counts` (f,); `face_from_base` (f)."""

    table: Array
    counts: np.ndarray
    face_from_base: Pose


@cache
def body_of(target: Target) -> Body:
    """The target as a solid body."""
    corners, counts, *_ = body_tables(target)
    base_from_face = base_from_faces(target)
    return Body(base_from_face @ corners, counts, base_from_face.inverse())


def by_reading(view: View, body: Body) -> Array:
    """A view's corners in the base frame for each of its readings, (r, n, 3)."""
    faces, is_turned = ways_of(view.readings)
    points = corners_in_base(body, view.corners, faces[:, None], is_turned[:, None])
    return points if view.sweep is None else points + view.sweep.shift(points)


def corners_in_base(
    body: Body, corners: np.ndarray, faces: np.ndarray, is_turned: np.ndarray
) -> Array:
    """Positions (…, 3) in the base frame of corner ids, given their face and whether it is read
    from its other end; the shapes of all three broadcast to (…)."""
    ids = np.where(is_turned, body.counts[faces] - 1 - corners, corners)
    return body.table[faces, ids]


@lru_cache(maxsize=4096)
def ways_of(readings: tuple[Reading, ...]) -> tuple[np.ndarray, np.ndarray]:
    """The face of each reading, and whether it is turned, (r,)."""
    faces = np.array([reading.face for reading in readings])
    return faces, np.array([reading.is_turned for reading in readings])
