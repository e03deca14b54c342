"""Which corners of a target a camera sees: front side, in the picture, nothing in between."""

from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np

from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array
from trigpoint.target import Face, Target

from .targets import panel

PICTURE_MARGIN_PX = 5.0
# The camera hangs on its own wall: what lies within a centimetre before the eye hides nothing.
NEAR_M = 0.01
STEEPEST_COSINE = 0.26  # of the angle between a face's normal and the line of sight: 75°


@dataclass(frozen=True, slots=True, eq=False)
class Wall:
    """An upright rectangle from the floor up; `start`, `end`: (2,) in the map, metres."""

    start: Array
    end: Array
    height: float
    shade: float = 0.7


@dataclass(frozen=True, slots=True, eq=False)
class SeenFace:
    """What can be seen of one face: `corners` (n,) ids and their true `pixels` (n, 2)."""

    face: Face
    corners: np.ndarray
    pixels: Array
    smallest_square_px: float


def seen_faces(
    target: Target,
    map_from_base: Pose,
    map_from_camera: Pose,
    model: CameraModel,
    walls: tuple[Wall, ...],
    others: tuple[tuple[Target, Pose], ...] = (),
) -> list[SeenFace]:
    """Every face that shows its front, with the corners that nothing hides; it may have none.

    `others`: the other robots' targets with their map_from_base; they may stand in between.
    """
    eye = map_from_camera.translation
    camera_from_map = map_from_camera.inverse()
    if not may_be_seen(target, map_from_base, map_from_camera, model):
        return []
    faces = []
    for face in target.faces:
        map_from_face = map_from_base @ face.base_from_face
        corners = map_from_face @ face.corners
        if not _shows_front(map_from_face, corners, eye):
            continue
        points = camera_from_map @ corners
        seen = _well_inside(model, points) & ~hidden_by_walls(eye, corners, walls)
        seen &= ~_hidden_by_faces(eye, corners, target, map_from_base, own=face)
        for other, map_from_other in others:
            seen &= ~_hidden_by_faces(eye, corners, other, map_from_other)
        pixels = model.project(np.where(seen[:, None], points, [0.0, 0.0, 1.0]))
        square = _smallest_square(face, model.project(points)) if np.any(seen) else 0.0
        ids = np.flatnonzero(seen).astype(np.uint16)
        faces.append(SeenFace(face, ids, pixels[seen], square))
    return faces


def may_be_seen(
    target: Target, map_from_base: Pose, map_from_camera: Pose, model: CameraModel
) -> np.ndarray:
    """False where the whole target lies outside the cone around the picture; quick. (n,) bool for
    many poses of the robot."""
    centre, radius = _ball(target)
    from_camera = map_from_camera.inverse() @ map_from_base
    offset = from_camera.rotation @ centre + from_camera.translation
    distance = np.linalg.norm(offset, axis=-1)
    safe = np.maximum(distance, radius)
    off_axis = np.arccos(np.clip(offset[..., 2] / safe, -1, 1)) - np.arcsin(radius / safe)
    return (distance <= radius) | (off_axis < _widest_angle(model))


@cache
def _ball(target: Target) -> tuple[Array, float]:
    """Centre and radius of a ball around a target's corners, in the robot's frame, metres."""
    corners = np.vstack([face.base_from_face @ face.corners for face in target.faces])
    centre = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    return centre, float(np.linalg.norm(corners - centre, axis=1).max())


@cache
def _widest_angle(model: CameraModel) -> float:
    """The angle between the axis and the picture's farthest corner, radians."""
    right, bottom = model.width - 0.5, model.height - 0.5
    edges = model.directions([[-0.5, -0.5], [right, -0.5], [right, bottom], [-0.5, bottom]])
    return float(np.arctan(np.linalg.norm(edges, axis=1).max()))


def _shows_front(map_from_face: Pose, corners: Array, eye: Array) -> bool:
    sight = eye - corners.mean(axis=0)
    cosine = -float(map_from_face.rotation[:, 2] @ sight) / float(np.linalg.norm(sight))
    return cosine > STEEPEST_COSINE


def _well_inside(model: CameraModel, points: Array) -> np.ndarray:
    inside = model.sees(points)
    u, v = np.moveaxis(model.project(np.where(inside[:, None], points, [0.0, 0.0, 1.0])), -1, 0)
    margin = PICTURE_MARGIN_PX
    inside &= (u > margin) & (u < model.width - 1 - margin)
    return inside & (v > margin) & (v < model.height - 1 - margin)


def _smallest_square(face: Face, pixels: Array) -> float:
    """The shortest side of a square in the picture, pixels."""
    grid = pixels.reshape(face.rows - 1, face.columns - 1, 2)
    sides = [np.linalg.norm(np.diff(grid, axis=axis), axis=-1) for axis in (0, 1)]
    return min(float(side.min()) for side in sides if side.size)


def _hidden_by_faces(
    eye: Array, points: Array, target: Target, map_from_base: Pose, *, own: Face | None = None
) -> np.ndarray:
    """Which points a target's sheets hide; `own`: the face that the points lie on."""
    hidden = np.zeros(len(points), dtype=bool)
    for face in target.faces:
        if face is not own:
            face_from_map = (map_from_base @ face.base_from_face).inverse()
            hidden |= _crosses_panel(face_from_map @ eye, face_from_map @ points, panel(face))
    return hidden


def _crosses_panel(eye: Array, points: Array, outline: Array) -> np.ndarray:
    """Whether the lines from `eye` to `points` (n, 3), in a face's frame, go through its sheet."""
    fall = eye[2] - points[:, 2]
    share = np.divide(eye[2], fall, out=np.full(len(points), -1.0), where=np.abs(fall) > 1e-12)
    crossing = eye[:2] + share[:, None] * (points[:, :2] - eye[:2])
    low, high = outline[:, :2].min(axis=0), outline[:, :2].max(axis=0)
    inside = np.all((crossing > low) & (crossing < high), axis=1)
    return inside & (share > 1e-6) & (share < 1 - 1e-6)


def hidden_by_walls(eye: Array, points: Array, walls: tuple[Wall, ...]) -> np.ndarray:
    """Which points (n, 3) a wall hides from `eye` (3,); (n,) bool."""
    if not walls:
        return np.zeros(len(points), dtype=bool)
    starts, runs, heights = _stacked(walls)
    sight = points - eye
    offset = starts - eye[:2]
    determinant = runs[:, 0, None] * sight[:, 1] - runs[:, 1, None] * sight[:, 0]
    parallel = np.abs(determinant) < 1e-12
    safe = np.where(parallel, 1.0, determinant)
    share = (offset[:, 1] * runs[:, 0] - offset[:, 0] * runs[:, 1])[:, None] / safe
    place = (offset[:, 1, None] * sight[:, 0] - offset[:, 0, None] * sight[:, 1]) / safe
    height = eye[2] + share * sight[:, 2]
    near = share * np.linalg.norm(sight, axis=1) < NEAR_M
    crosses = (share > 0) & (share < 1) & (place >= 0) & (place <= 1) & ~near & ~parallel
    return np.any(crosses & (height >= 0) & (height <= heights[:, None]), axis=0)


@lru_cache(maxsize=16)
def _stacked(walls: tuple[Wall, ...]) -> tuple[Array, Array, Array]:
    """Starts (n, 2), runs (n, 2) and heights (n,) of walls."""
    starts = np.array([wall.start for wall in walls])
    ends = np.array([wall.end for wall in walls])
    return starts, ends - starts, np.array([wall.height for wall in walls])
