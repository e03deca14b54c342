"""Cameras that tests and benchmarks hang up."""

import numpy as np
from numpy.typing import ArrayLike

from trigpoint.geometry import Pose


def looking_at(eye: ArrayLike, goal: ArrayLike) -> Pose:
    """map_from_camera of a camera at `eye` (3,) that looks at a point, its picture upright; not
    straight up or down."""
    place = np.array(eye, dtype=float)
    ahead = np.asarray(goal, dtype=float) - place
    ahead = ahead / np.linalg.norm(ahead)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right = right / np.linalg.norm(right)
    return Pose(np.column_stack([right, np.cross(ahead, right), ahead]), place)
