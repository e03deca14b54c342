"""The floor on which a camera sees the target."""

import numpy as np

from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array
from trigpoint.site.target import Target

# A square's side below this many pixels is too small to be found.
_LEAST_SQUARE_PX = 6.0
_FURTHEST_M = 12.0
_STEP_M = 0.1
_RAYS = 48


def coverage(map_from_camera: Pose, lens: CameraModel, target: Target) -> Array:
    """The polygon (n, 3) on the floor z = 0 over which the target's middle is in the picture and
    its squares are large enough; (0, 3) where there is none."""
    height = float(np.mean([face.translation[2] for face in target.faces]))
    square = min(face.square for face in target.faces)
    eye = map_from_camera.translation
    ahead = map_from_camera.rotation[:, 2]
    middle = np.arctan2(ahead[1], ahead[0])
    angles = middle + np.linspace(-np.pi, np.pi, _RAYS * 4, endpoint=False)
    radii = np.arange(_STEP_M, _FURTHEST_M, _STEP_M)
    along = np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=-1)
    below = np.array([eye[0], eye[1], height])
    # Most points are too far off or behind the camera; only for the others it matters what the
    # lens does.
    depth = np.outer(along @ ahead, radii) + (below - eye) @ ahead
    ray, step = np.nonzero((depth > 0) & (depth <= lens.fx * square / _LEAST_SQUARE_PX))
    points = below + along[ray] * radii[step, None]
    seen = lens.sees((points - eye) @ map_from_camera.rotation)
    points, ray = points[seen], ray[seen]
    near = np.flatnonzero(np.diff(ray, prepend=-1))
    if len(near) < 2:
        return np.zeros((0, 3))
    far = np.append(near[1:], len(ray)) - 1
    outline = np.concatenate([points[far], points[near][::-1]])
    outline[:, 2] = 0.0
    return outline
