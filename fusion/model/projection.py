"""Projects corners into a picture, with the derivative by the poses that they depend on."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array

# Points behind a camera, or nearer to its plane than this, are put this far in front of it: there a
# residual is large and its derivative harmless.
NEAREST_M = 1e-2


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
    arm = points @ np.swapaxes(frame_from_body.rotation, -1, -2)
    optical = arm + frame_from_body.translation[..., None, :]
    if frame_from_camera is not None:
        optical = (optical - frame_from_camera.translation) @ frame_from_camera.rotation
    is_ahead = optical[..., 2] > NEAREST_M
    pixels, by_point = lens.project_by_point(before_camera(optical))
    if frame_from_camera is not None:
        by_point = by_point @ frame_from_camera.rotation.T
    return Projection(pixels, by_disturbance(by_point, arm), is_ahead)


def before_camera(optical: Array) -> Array:
    """Points (…, 3) in the optical frame, pushed to at least `NEAREST_M` in front of it."""
    pushed = optical.copy()
    pushed[..., 2] = np.maximum(optical[..., 2], NEAREST_M)
    return pushed


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
