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


class Body(Struct, frozen=True, eq=False):
    """A target in the robot's base frame.

    `table` (f, c, 3): the faces' corners by id, padded to one size, with how many a face has in
    `counts` (f,); `base_from_face`, `face_from_base` (f); `low`, `high` (f, 2): the rectangle of a
    face's pattern in its own frame, metres.
    """

    table: Array
    counts: np.ndarray
    base_from_face: Pose
    face_from_base: Pose
    low: Array
    high: Array


@cache
def body_of(target: Target) -> Body:
    """The target as a solid body."""
    outlines = np.stack([face.outline[:, :2] for face in target.faces])
    counts = np.array([face.corner_count for face in target.faces])
    table = np.zeros((len(counts), counts.max(), 3))
    for face, row in zip(target.faces, table, strict=True):
        row[: face.corner_count] = face.base_from_face @ face.corners
    base_from_face = base_from_faces(target)
    return Body(
        table,
        counts,
        base_from_face,
        base_from_face.inverse(),
        outlines.min(axis=1),
        outlines.max(axis=1),
    )


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
