"""A target as an opaque solid: where its corners are, and which of them can be seen from where.

A face shows its pattern on its front alone, and no corner can be seen through another face. So a
reading that would need either is none, however well its corners fit.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.target import Target

from .observations import View

# Faces are not mounted exactly where the target file says, so a corner at the edge of what another
# face hides may be seen; a view most of whose corners are hidden can't.
_HIDDEN_SHARE = 0.5
_BESIDE = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A target in the robot's base frame.

    `corners`: a face's, by id, (c, 3) each; `base_from_face` (f); `low`, `high` (f, 2): the
    rectangle of a face's pattern in its own frame, metres.
    """

    corners: tuple[Array, ...]
    base_from_face: Pose
    low: Array
    high: Array


@cache
def body_of(target: Target) -> Body:
    """The solid that a target is."""
    poses = [face.base_from_face for face in target.faces]
    outlines = np.stack([face.outline[:, :2] for face in target.faces])
    corners = tuple(p @ face.corners for p, face in zip(poses, target.faces, strict=True))
    return Body(corners, Pose.stack(poses), outlines.min(axis=1), outlines.max(axis=1))


def by_reading(view: View, body: Body) -> Array:
    """A view's corners in the base frame by each of its readings, (r, n, 3)."""
    return np.stack(
        [
            body.corners[r.face][::-1][view.corners]
            if r.is_turned
            else body.corners[r.face][view.corners]
            for r in view.readings
        ]
    )


def faces_of(view: View) -> np.ndarray:
    """The face of each of a view's readings, (r,)."""
    return np.array([reading.face for reading in view.readings])


def outermost(pixels: Array) -> np.ndarray:
    """Indices of the corners that reach furthest in four directions."""
    u, v = pixels.T
    return np.unique([np.argmin(u + v), np.argmax(u + v), np.argmin(u - v), np.argmax(u - v)])


def can_be_seen(body: Body, faces: np.ndarray, points: Array, eye: Array) -> np.ndarray:
    """Whether eyes (b, 3) see faces (r,) with points on them (r, k, 3) from in front and past all
    other faces; base frame; (b, r) bool."""
    return _from_in_front(body, faces, eye) & ~_hidden(body, faces, points, eye)


def _from_in_front(body: Body, faces: np.ndarray, eye: Array) -> np.ndarray:
    # z of a face points into the board, so away from whoever sees its front.
    into = body.base_from_face.rotation[faces, :, 2]
    sight = eye[:, None] - body.base_from_face.translation[faces]
    return np.sum(into * sight, axis=-1) < 0


def _hidden(body: Body, faces: np.ndarray, points: Array, eye: Array) -> np.ndarray:
    """Whether most of the lines from the eyes to the points go through another face, (b, r)."""
    face_from_base = body.base_from_face.inverse()
    eyes = face_from_base @ np.broadcast_to(eye, (len(face_from_base), *eye.shape))
    ends = face_from_base @ np.broadcast_to(
        points.reshape(-1, 3), (len(eyes), points[..., 0].size, 3)
    )
    ends = ends.reshape(len(eyes), *points.shape)
    start, end = eyes[:, :, None, None], ends[:, None]  # (f, b, 1, 1, 3), (f, 1, r, k, 3)
    fall = start[..., 2] - end[..., 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = start[..., 2] / fall
        crossing = start[..., :2] + share[..., None] * (end[..., :2] - start[..., :2])
        low, high = body.low[:, None, None, None], body.high[:, None, None, None]
        through = np.all((crossing > low) & (crossing < high), axis=-1)
        through &= (share > _BESIDE) & (share < 1 - _BESIDE)
    through &= (np.arange(len(eyes))[:, None] != faces)[:, None, :, None]
    return np.any(through, axis=0).mean(axis=-1) > _HIDDEN_SHARE
