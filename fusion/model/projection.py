"""Projects corners into a picture, with the derivative by the poses that they depend on."""

import math

import numpy as np
from msgspec import Struct

from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In, Kernel, Out

# Points behind a camera, or nearer to its plane than this, are put this far in front of it: there a
# residual is large and its derivative harmless.
NEAREST_M = 1e-2
_HERE = Pose.identity()
_REAL = np.float64
_PROJECTED = Kernel(
    "tp_projected",
    In(_REAL, ("p",)),
    In(_REAL, ("b", 3, 3)),
    In(_REAL, ("b", 3)),
    In(_REAL, ("b", "k", 3)),
    In(_REAL, (3, 3)),
    In(_REAL, (3,)),
    Out(_REAL, ("b", "k", 2)),
    Out(_REAL, ("b", "k", 12)),
    Out(np.bool_, ("b", "k")),
)


class Projection(Struct, frozen=True):
    """Corners of a body in a picture: `pixels` (…, k, 2); `by_body`: their derivative (…, k, 2, 6)
    by a disturbance of the body's pose; `is_ahead` (…, k): whether a corner is in front of the
    camera."""

    pixels: Array
    by_body: Array
    is_ahead: np.ndarray


def projected(
    lens: CameraModel, frame_from_body: Pose, points: Array, frame_from_camera: Pose | None = None
) -> Projection:
    """Project points (…, k, 3) of a body at its poses (…) into a camera; without
    `frame_from_camera` the poses are in the camera's optical frame."""
    camera = _HERE if frame_from_camera is None else frame_from_camera
    shape = np.broadcast_shapes(points.shape[:-2], frame_from_body.translation.shape[:-1])
    corners = points.shape[-2]
    count = math.prod(shape)
    pixels, by_body = np.empty((count, corners, 2)), np.empty((count, corners, 12))
    is_ahead = np.empty((count, corners), dtype=bool)
    _PROJECTED(
        lens.parameters,
        *_many(frame_from_body, shape),
        np.ascontiguousarray(np.broadcast_to(points, (*shape, corners, 3))).reshape(-1, corners, 3),
        np.ascontiguousarray(camera.rotation),
        np.ascontiguousarray(camera.translation),
        pixels,
        by_body,
        is_ahead,
    )
    rows = (*shape, corners)
    return Projection(
        pixels.reshape(*rows, 2), by_body.reshape(*rows, 2, 6), is_ahead.reshape(rows)
    )


def _many(poses: Pose, shape: tuple[int, ...]) -> tuple[Array, Array]:
    """Poses of some leading shape as the core takes them: (b, 3, 3) and (b, 3)."""
    rotation = np.broadcast_to(poses.rotation, (*shape, 3, 3)).reshape(-1, 3, 3)
    translation = np.broadcast_to(poses.translation, (*shape, 3)).reshape(-1, 3)
    return np.ascontiguousarray(rotation), np.ascontiguousarray(translation)
