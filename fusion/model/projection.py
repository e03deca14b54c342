"""Projects corners into a picture, with the derivative by the poses that they depend on."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

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


@dataclass(frozen=True, slots=True)
class Projection:
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


def by_disturbance(by_point: Array, arm: Array, tangent: Sequence[int] = range(6)) -> Array:
    """Derivative (…, k, 2, d) by the components `tangent` of a disturbance of the pose of a body
    that carries the points: metres, then radians, by the contract, t' = t + δt, R' = Exp(δθ) R.

    `by_point`: (…, k, 2, 3) by the point, in the axes of the pose's parent; `arm`: (…, k, 3) the
    point from the body's origin, in the same axes. With p = t + a: ∂p/∂δt = I, ∂p/∂δθ = -[a]× (Solà
    et al., section 4), and a row b of `by_point` times -[a]× is a × b. To a camera the points move
    the opposite way: the derivative by its pose is this one with `-by_point`, and the point from
    the camera as `arm`.
    """
    result = np.empty((*by_point.shape[:-1], len(tangent)))
    for column, component in enumerate(tangent):
        if component < 3:
            result[..., column] = by_point[..., component]
        else:
            i, j = (component + 1) % 3, (component + 2) % 3
            result[..., column] = by_point[..., j] * arm[..., i, None]
            result[..., column] -= by_point[..., i] * arm[..., j, None]
    return result
