"""Which corners of a target a camera sees: front side, in the picture, nothing in between."""

from collections.abc import Iterable
from functools import cache, lru_cache

import numpy as np
from msgspec import Struct

from trigpoint.contract.messages import FaceSighting
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array
from trigpoint.site.target import Face, Pattern, Target

from .targets import panel

PICTURE_MARGIN_PX = 5.0
# The camera hangs on its own wall: what lies within a centimetre before the eye hides nothing.
NEAR_M = 0.01
FEWEST_CORNERS = 6  # of a board that may be seen in part
STEEPEST_COSINE = 0.26  # of the angle between a face's normal and the line of sight: 75°


class Wall(Struct, frozen=True, eq=False):
    """An upright rectangle from the floor up; `start`, `end`: (2,) in the map, metres."""

    start: Array
    end: Array
    height: float
    shade: float = 0.7


class SeenFace(Struct, frozen=True, eq=False):
    """What can be seen of one face: `corners` (n,) ids and their true `pixels` (n, 2)."""

    face: Face
    corners: np.ndarray
    pixels: Array
    smallest_square_px: float

    def is_found(self, smallest_square_px: float) -> bool:
        """Whether a good detector finds it: a checkerboard only as a whole."""
        is_whole = self.face.pattern is Pattern.CHECKERBOARD
        count = self.face.corner_count
        needed = count if is_whole else min(FEWEST_CORNERS, count)
        return len(self.corners) >= needed and self.smallest_square_px >= smallest_square_px

    def sighting(self, target: Target, name: str, pixels: Array, sigma: float) -> FaceSighting:
        """What a detector says of it; `name`: of the target, as `told_name`; `pixels`: (n, 2)."""
        number = self.face.id if len(target.look_alikes(self.face.appearance)) == 1 else -1
        return FaceSighting(name, number, self.corners, pixels.astype(np.float32), sigma)


def told_name(target: Target, others: Iterable[Target]) -> str:
    """The target's name, or "" where another one has the same pattern."""
    own = {face.appearance for face in target.faces}
    is_shared = any(face.appearance in own for other in others for face in other.faces)
    return "" if is_shared else target.name


def seen_faces(
    target: Target,
    map_from_base: Pose,
    map_from_camera: Pose,
    model: CameraModel,
    walls: tuple[Wall, ...],
) -> list[SeenFace]:
    """`seen_faces_each` of a robot at one pose, with no other in between."""
    [faces] = seen_faces_each(target, Pose.stack([map_from_base]), map_from_camera, model, walls)
    return faces


def seen_faces_each(
    target: Target,
    map_from_base: Pose,
    map_from_camera: Pose,
    model: CameraModel,
    walls: tuple[Wall, ...],
    others: tuple[tuple[Target, Pose], ...] = (),
) -> list[list[SeenFace]]:
    """For each of many poses (n) of the robot every face that shows its front, with the corners
    that nothing hides; it may have none. `others`: the other robots' targets with their
    map_from_base (n); they may stand in between."""
    found: list[list[SeenFace]] = [[] for _ in range(len(map_from_base))]
    near = np.flatnonzero(may_be_seen(target, map_from_base, map_from_camera, model))
    if not len(near):
        return found
    eye, camera_from_map = map_from_camera.translation, map_from_camera.inverse()
    for face in target.faces:
        map_from_face = map_from_base[near] @ _base_from_face(face)
        in_front = _shows_front(map_from_face, face.corners.mean(axis=0), eye)
        moments = near[in_front]
        corners = map_from_face[in_front] @ face.corners
        points = camera_from_map @ corners
        seen = model.sees(points, margin_px=PICTURE_MARGIN_PX)
        if np.any(seen):
            seen &= ~hidden_by_walls(eye, corners.reshape(-1, 3), walls).reshape(seen.shape)
            seen &= ~_hidden_by_faces(eye, corners, target, map_from_base[moments], own=face)
            for other, map_from_other in others:
                seen &= ~_hidden_by_faces(eye, corners, other, map_from_other[moments])
        pixels = model.project(np.where(seen[..., None], points, [0.0, 0.0, 1.0]))
        for row, moment in enumerate(moments.tolist()):
            is_any = np.any(seen[row])
            square = smallest_square(face, model.project(points[row])) if is_any else 0.0
            ids = np.flatnonzero(seen[row]).astype(np.uint16)
            found[moment].append(SeenFace(face, ids, pixels[row, seen[row]], square))
    return found


@cache
def _base_from_face(face: Face) -> Pose:
    return face.base_from_face


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


def _shows_front(map_from_face: Pose, middle: Array, eye: Array) -> np.ndarray:
    """Whether faces (n) turn their front to the eye; `middle`: of their corners; (n,) bool."""
    sight = eye - (map_from_face.rotation @ middle + map_from_face.translation)
    into = map_from_face.rotation[..., 2]
    return -np.sum(into * sight, axis=-1) > STEEPEST_COSINE * np.linalg.norm(sight, axis=-1)


def smallest_square(face: Face, pixels: Array) -> float:
    """The shortest side of a square, or of a tag, in the picture, pixels."""
    if face.pattern is Pattern.APRILGRID:
        tags = pixels.reshape(-1, 4, 2)
        return float(np.linalg.norm(tags - np.roll(tags, 1, axis=1), axis=-1).min())
    grid = pixels.reshape(face.rows - 1, face.columns - 1, 2)
    sides = [np.linalg.norm(np.diff(grid, axis=axis), axis=-1) for axis in (0, 1)]
    return min(float(side.min()) for side in sides if side.size)


def _hidden_by_faces(
    eye: Array, points: Array, target: Target, map_from_base: Pose, *, own: Face | None = None
) -> np.ndarray:
    """Which points (n, k, 3) the sheets of a target at poses (n) hide; `own`: the face that the
    points lie on; (n, k) bool."""
    base_from_sheet, low, high = _sheets(target, own)
    base = Pose(map_from_base.rotation[:, None], map_from_base.translation[:, None])
    sheet_from_map = (base @ base_from_sheet).inverse()  # (n, sheets)
    start = (sheet_from_map.rotation @ eye + sheet_from_map.translation)[:, :, None]
    there = sheet_from_map @ points[:, None]
    fall = start[..., 2] - there[..., 2]
    share = np.full(fall.shape, -1.0)
    np.divide(start[..., 2], fall, out=share, where=np.abs(fall) > 1e-12)
    crossing = start[..., :2] + share[..., None] * (there[..., :2] - start[..., :2])
    inside = np.all((crossing > low) & (crossing < high), axis=-1)
    return np.any(inside & (share > 1e-6) & (share < 1 - 1e-6), axis=1)


@cache
def _sheets(target: Target, own: Face | None) -> tuple[Pose, Array, Array]:
    """base_from_face of a target's sheets (m) but `own`, and where each begins and ends in its
    plane, (m, 1, 2)."""
    faces = [face for face in target.faces if face is not own]
    outlines = np.array([panel(face)[:, :2] for face in faces]).reshape(-1, 4, 2)
    poses = Pose.stack([face.base_from_face for face in faces])
    return poses, outlines.min(axis=1)[:, None], outlines.max(axis=1)[:, None]


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
