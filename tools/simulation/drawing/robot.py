"""Draws a robot into a part of a picture: shadow, body, mast, and the target's sheets.

The sheets are exact: each subpixel's ray, through the lens, meets the sheet's plane, and the
texture is averaged over the pixel and over the exposure, each row's own where the shutter rolls, so
corners have no bias. Body and shadow are outlines, good enough for the eye.
"""

from collections.abc import Callable
from functools import cache

import cv2
import numpy as np
from msgspec import Struct

from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array, wrap
from trigpoint.site.target import Face, Target
from trigpoint.tools.shapes.bodies import HALF_THICKNESS
from trigpoint.tools.simulation.motion.actors import SimulatedRobot
from trigpoint.tools.simulation.sight.targets import panel

from .lens_grid import SUBPIXELS, subpixel_centres
from .textures import level_for, texture

_BODY_RADIUS, _BODY_HEIGHT, _MAST_RADIUS = 0.19, 0.22, 0.022
_SHIFT = 4  # fractional bits of outlines
_ROLLED_MARGIN = 12  # pixels that a robot may go while its sheet's rows are exposed
_LAMP = np.array([0.35, 0.2, 0.9]) / np.linalg.norm([0.35, 0.2, 0.9])

Region = tuple[slice, slice]


class Canvas(Struct, eq=False):
    """A part of a picture. `rays`: the whole picture's `subpixel_rays`; `grey`: the part's values,
    (h, w) float32, drawn on in place, before vignetting; `onward`: the robot's motion, from_later,
    until rows (n,) are exposed, None where all are at once."""

    model: CameraModel
    rays: np.ndarray
    region: Region
    grey: np.ndarray
    onward: Callable[[Array], Pose] | None = None

    @property
    def corner(self) -> Array:
        return np.array([self.region[1].start, self.region[0].start], dtype=float)


def region_of(model: CameraModel, camera_from_base: Pose, target: Target) -> Region | None:
    """The part of the picture that a robot can touch, or None."""
    points = camera_from_base @ _hull(target)
    if np.any(points[:, 2] < 0.1) or not _is_near_axis(model, points):
        return None
    return _box(_projected(model, points), np.s_[: model.height, : model.width], margin=6)


def draw_robot(
    canvas: Canvas, robot: SimulatedRobot, camera_from_map: Pose, map_from_base: Pose
) -> None:
    """Draw from the floor up and from far to near; `map_from_base`: (k), poses to average."""
    poses = camera_from_map @ map_from_base
    middle = poses[len(poses) // 2]
    _draw_shadow(canvas, middle)
    _draw_body(canvas, middle)
    behind, before = far_to_near(robot.target, middle.inverse().translation)
    for face in behind:
        _draw_sheet(canvas, face, poses, map_from_base)
    _draw_mast(canvas, middle, robot.target)
    for face in before:
        _draw_sheet(canvas, face, poses, map_from_base)


def far_to_near(target: Target, camera_in_base: Array) -> tuple[list[Face], list[Face]]:
    """Sheets behind the robot's axis and before it, each in the order in which to paint them.

    Sheets stand on rays from the axis: one hides another only where it lies at a smaller angle from
    the camera's direction, on the same side.
    """
    direction = np.arctan2(camera_in_base[1], camera_in_base[0])

    def angle(face: Face) -> float:
        centre = face.base_from_face @ face.corners.mean(axis=0)
        return abs(float(wrap(np.arctan2(centre[1], centre[0]) - direction)))

    faces = sorted(target.faces, key=angle, reverse=True)
    behind = [face for face in faces if angle(face) > np.pi / 2]
    return behind, faces[len(behind) :]


def _draw_sheet(canvas: Canvas, face: Face, poses: Pose, map_from_base: Pose) -> None:
    """Draw a face that shows the camera its front, on its plate."""
    middle = poses[len(poses) // 2]
    camera_in_face = (middle @ face.base_from_face).inverse().translation
    if camera_in_face[2] < -1e-3:  # the z axis points into the board, away from the reader
        _draw_plate(canvas, middle, face)
        _draw_face(canvas, face, poses, _light(face, map_from_base[0]))


def _draw_face(canvas: Canvas, face: Face, poses: Pose, light: float) -> None:
    outline = poses @ face.base_from_face @ panel(face)
    pixels = _projected(canvas.model, outline.reshape(-1, 3))
    box = _box(pixels, canvas.region, margin=2 if canvas.onward is None else _ROLLED_MARGIN)
    if box is None:
        return
    height, width = box[0].stop - box[0].start, box[1].stop - box[1].start
    sheet = texture(face, level_for(_square_px(canvas.model, poses[0] @ face.base_from_face, face)))
    rays = canvas.rays[_finer(box[0]), _finer(box[1])]
    total = np.zeros((height, width, 2), np.float32)
    at_rows = canvas.onward and canvas.onward(subpixel_centres(canvas.model.height)[_finer(box[0])])
    for i in range(len(poses)):
        pose = poses[i] if at_rows is None else poses[i] @ at_rows
        face_from_camera = (pose @ face.base_from_face).inverse()
        u, v = _meet(sheet.matrix @ _plane_from_ray(face_from_camera), rays)
        sampled = cv2.remap(sheet.texels, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        total += cv2.resize(
            sampled.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA
        )
    total /= len(poses)
    part = _within(box, canvas.region)
    canvas.grey[part] = light * total[..., 0] + (1 - total[..., 1] / 255) * canvas.grey[part]


def _plane_from_ray(face_from_camera: Pose) -> Array:
    """(…, 3, 3): where the ray of (x, y, 1) in the camera meets z = 0 of a face, as x, y, w
    there."""
    rotation, eye = face_from_camera.rotation, face_from_camera.translation[..., None]
    # The point eye + share · (R ray) has z = 0 at share = -eye_z / (R ray)_z.
    along, fall = rotation[..., :2, :], rotation[..., 2:, :]
    return np.concatenate([eye[..., :2, :] * fall - eye[..., 2:, :] * along, fall], axis=-2)


def _meet(texel_from_ray: Array, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Texel coordinates of `rays` (h, w, 2), each (h, w) float32; one matrix, or one a row."""
    m = texel_from_ray.astype(np.float32).reshape(-1, 3, 3).transpose(1, 2, 0)[..., None]
    x, y = rays[..., 0], rays[..., 1]
    w = m[2, 0] * x + m[2, 1] * y + m[2, 2]
    u = (m[0, 0] * x + m[0, 1] * y + m[0, 2]) / w
    v = (m[1, 0] * x + m[1, 1] * y + m[1, 2]) / w
    return u, v


def _finer(pixels: slice) -> slice:
    return slice(pixels.start * SUBPIXELS, pixels.stop * SUBPIXELS)


def _square_px(model: CameraModel, camera_from_face: Pose, face: Face) -> float:
    """The longer side of a square in the picture, but at most twice the shorter one: seen almost
    from its edge, a pattern is grey and not moiré."""
    top_left, top_right, _, bottom_left = model.project(camera_from_face @ face.outline)
    across = float(np.linalg.norm(top_right - top_left)) / face.columns
    down = float(np.linalg.norm(bottom_left - top_left)) / face.rows
    return min(max(across, down), 2 * min(across, down))


def _light(face: Face, map_from_base: Pose) -> float:
    """How bright a sheet is under lamps above and to one side."""
    normal = -(map_from_base @ face.base_from_face).rotation[:, 2]
    return 0.82 + 0.30 * float(normal @ _LAMP)


def _draw_shadow(canvas: Canvas, camera_from_base: Pose) -> None:
    mask = np.zeros(canvas.grey.shape, np.uint8)
    _fill(canvas, mask, camera_from_base @ _disc(_BODY_RADIUS + 0.04, 0.0), 255)
    mask = cv2.blur(mask, (15, 15))
    canvas.grey *= 1 - 0.55 * mask.astype(np.float32) / 255


def _draw_body(canvas: Canvas, camera_from_base: Pose) -> None:
    low, high = _disc(_BODY_RADIUS, 0.02), _disc(_BODY_RADIUS, _BODY_HEIGHT)
    _paint(canvas, camera_from_base @ np.vstack([low, high]), 58)
    middle = _disc(_BODY_RADIUS + 0.003, 0.09), _disc(_BODY_RADIUS + 0.003, 0.11)
    _paint(canvas, camera_from_base @ np.vstack(middle), 84)
    _paint(canvas, camera_from_base @ high, 92)
    _paint(canvas, camera_from_base @ _disc(0.06, _BODY_HEIGHT, (0.10, 0.0)), 150)


def _draw_mast(canvas: Canvas, camera_from_base: Pose, target: Target) -> None:
    top = max(float((face.base_from_face @ panel(face))[:, 2].max()) for face in target.faces)
    mast = np.vstack([_disc(_MAST_RADIUS, _BODY_HEIGHT), _disc(_MAST_RADIUS, top)])
    _paint(canvas, camera_from_base @ mast, 120)
    _paint(canvas, camera_from_base @ _disc(_MAST_RADIUS, top), 160)


def _draw_plate(canvas: Canvas, camera_from_base: Pose, face: Face) -> None:
    back = panel(face) + np.array([0, 0, 2 * HALF_THICKNESS])
    plate = camera_from_base @ face.base_from_face @ np.vstack([panel(face), back])
    _paint(canvas, plate, 170)


def _paint(canvas: Canvas, points: Array, grey: int) -> None:
    """Fill the convex outline of `points` (n, 3) in the camera's frame."""
    mask = np.zeros(canvas.grey.shape, np.uint8)
    _fill(canvas, mask, points, 255)
    share = mask.astype(np.float32) / 255
    canvas.grey += share * (grey - canvas.grey)


def _fill(canvas: Canvas, mask: np.ndarray, points: Array, value: int) -> None:
    pixels = (_projected(canvas.model, points) - canvas.corner).astype(np.float32)
    outline = np.round(cv2.convexHull(pixels) * 2**_SHIFT).astype(np.int32)
    cv2.fillConvexPoly(mask, outline, (value,), lineType=cv2.LINE_AA, shift=_SHIFT)


def _disc(radius: float, height: float, centre: tuple[float, float] = (0.0, 0.0)) -> Array:
    """A level circle in the robot's frame, (32, 3)."""
    angles = np.linspace(0, 2 * np.pi, 32, endpoint=False)
    x, y = centre[0] + radius * np.cos(angles), centre[1] + radius * np.sin(angles)
    return np.column_stack([x, y, np.full_like(x, height)])


def _hull(target: Target) -> Array:
    """Points around everything of a robot, (n, 3) in its frame."""
    sheets = [face.base_from_face @ panel(face) for face in target.faces]
    discs = [_disc(_BODY_RADIUS + 0.06, height) for height in (0.0, _BODY_HEIGHT)]
    return np.vstack([*sheets, *discs])


def _projected(model: CameraModel, points: Array) -> Array:
    """Pixels of points (n, 3); one far outside the picture, where the lens polynomial folds back,
    is first brought nearer on its own ray from the axis, to where it is still outside."""
    normalised = points[:, :2] / points[:, 2:]
    radius = np.linalg.norm(normalised, axis=1, keepdims=True)
    near = normalised * np.minimum(1.0, _outside(model) / np.maximum(radius, 1e-9))
    return model.project(np.column_stack([near, np.ones(len(near))]))


@cache
def _outside(model: CameraModel) -> float:
    """A radius a little beyond the picture's furthest corner, x/z and y/z."""
    corners = [[u, v] for u in (0, model.width - 1) for v in (0, model.height - 1)]
    return 1.1 * float(np.linalg.norm(model.directions(corners), axis=1).max())


def _is_near_axis(model: CameraModel, points: Array) -> bool:
    """Whether a point lies where the lens model still holds: not far outside the picture."""
    reach = np.hypot(max(model.cx, model.width) / model.fx, max(model.cy, model.height) / model.fy)
    return bool(np.any(np.hypot(points[:, 0], points[:, 1]) / points[:, 2] < 0.9 * reach))


def _box(pixels: Array, region: Region, *, margin: int) -> Region | None:
    """The part of a region around `pixels` (n, 2), or None where they are all outside."""
    rows, columns = region
    low = np.floor(pixels.min(axis=0)).astype(int) - margin
    high = np.ceil(pixels.max(axis=0)).astype(int) + margin + 1
    left, top = np.maximum(low, [columns.start or 0, rows.start or 0])
    right, bottom = np.minimum(high, [columns.stop, rows.stop])
    if left >= right or top >= bottom:
        return None
    return np.s_[int(top) : int(bottom), int(left) : int(right)]


def _within(box: Region, region: Region) -> Region:
    """`box` in the region's own coordinates."""
    down, across = region[0].start, region[1].start
    rows = slice(box[0].start - down, box[0].stop - down)
    return rows, slice(box[1].start - across, box[1].stop - across)
