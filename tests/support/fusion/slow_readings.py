"""How well readings of a view fit, written out with numpy; the core is held to it."""

import numpy as np

from trigpoint.fusion.model.observations import View, corners_in_base
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array
from trigpoint.site.target import Target

_AHEAD_M, _BESIDE, _HIDDEN_SHARE = 1e-3, 1e-3, 0.5


def slow_rms_px(view: View, target: Target, lens: CameraModel, camera_from_base: Pose) -> Array:
    """Reprojection RMS of a coordinate for each of a view's readings (r,), pixels; infinite for a
    face that would be seen from behind or through another."""
    found = []
    for reading in view.readings:
        points = corners_in_base(view, reading, target)
        optical = camera_from_base @ points
        eye = camera_from_base.inverse().translation
        outer = points[outermost(view.pixels)]
        if np.all(optical[:, 2] > _AHEAD_M) and sees(target, reading.face, outer, eye):
            found.append(float(np.sqrt(np.mean((lens.project(optical) - view.pixels) ** 2))))
        else:
            found.append(np.inf)
    return np.array(found)


def outermost(pixels: Array) -> np.ndarray:
    """Indices of the corners that reach furthest in four directions."""
    u, v = pixels.T
    rising, falling = u + v, u - v
    return np.array(sorted({rising.argmin(), rising.argmax(), falling.argmin(), falling.argmax()}))


def sees(target: Target, face: int, points: Array, eye: Array) -> bool:
    """Whether an eye (3,) in the base frame is in front of a face and sees at least half of these
    points (k, 3) of it past all others."""
    pose = target.faces[face].base_from_face
    if pose.rotation[:, 2] @ (eye - pose.translation) >= 0:
        return False
    hidden = np.zeros(len(points), dtype=bool)
    for other, each in enumerate(target.faces):
        start = each.base_from_face.inverse() @ eye
        for row, end in enumerate(each.base_from_face.inverse() @ points):
            share = start[2] / (start[2] - end[2])
            crossing = (start + share * (end - start))[:2]
            low, high = each.outline[:, :2].min(axis=0), each.outline[:, :2].max(axis=0)
            is_inside = np.all((crossing > low) & (crossing < high))
            hidden[row] |= other != face and _BESIDE < share < 1 - _BESIDE and bool(is_inside)
    return bool(hidden.mean() <= _HIDDEN_SHARE)
