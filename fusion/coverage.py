"""The floor on which a camera sees the target."""

import numpy as np

from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array
from trigpoint.target import Target

# A square's side below this many pixels is too small to be found.
_LEAST_SQUARE_PX = 6.0
_FURTHEST_M = 12.0
_STEP_M = 0.1
_RAYS = 48


def coverage(map_from_camera: Pose, lens: CameraModel, target: Target) -> Array:
    """The polygon (n, 3) on the floor z = 0 over which the target's middle is in the picture and
    its squares are large enough; (0, 3) where there is no such floor."""
    height = float(np.mean([face.base_from_face.translation[2] for face in target.faces]))
    square = min(face.square for face in target.faces)
    eye = map_from_camera.translation
    ahead = map_from_camera.rotation[:, 2]
    middle = np.arctan2(ahead[1], ahead[0])
    angles = middle + np.linspace(-np.pi, np.pi, _RAYS * 4, endpoint=False)
    radii = np.arange(_STEP_M, _FURTHEST_M, _STEP_M)
    x = eye[0] + np.cos(angles)[:, None] * radii
    y = eye[1] + np.sin(angles)[:, None] * radii
    points = np.stack([x, y, np.full_like(x, height)], axis=-1)
    optical = map_from_camera.inverse() @ points.reshape(-1, 3)
    large = lens.fx * square / np.maximum(optical[:, 2], 1e-3) >= _LEAST_SQUARE_PX
    # Most points are too far off; only for the others it matters what the lens does.
    near_enough = np.flatnonzero(large & (optical[:, 2] > 0))
    seen = np.zeros(x.size, dtype=bool)
    seen[near_enough] = lens.sees(optical[near_enough])
    seen = seen.reshape(x.shape)
    rays = np.flatnonzero(seen.any(axis=1))
    if len(rays) < 2:
        return np.zeros((0, 3))
    near = np.array([np.flatnonzero(seen[ray])[0] for ray in rays])
    far = np.array([np.flatnonzero(seen[ray])[-1] for ray in rays])
    outline = np.concatenate([points[rays, far], points[rays, near][::-1]])
    outline[:, 2] = 0.0
    return outline
