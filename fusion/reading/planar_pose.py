"""Where a target is before a camera, from one picture: every pose that fits, best first.

One plane has two solutions, which often fit equally well (Collins and Bartoli, «Infinitesimal
plane-based pose estimation», 2014); two faces together are solid and have one.
"""

import numpy as np
from msgspec import Struct

from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In, Kernel, Out

_REAL = np.float64
_PLANE = Kernel(
    "tp_plane_poses",
    In(_REAL, ("p",)),
    In(_REAL, ("n", 3)),
    In(_REAL, ("n", 2)),
    float,
    Out(_REAL, (2, 3, 3)),
    Out(_REAL, (2, 3)),
    Out(_REAL, (2,)),
)


class PoseFit(Struct, frozen=True):
    """camera_from_object, and the reprojection's RMS of a coordinate in sigmas."""

    pose: Pose
    rms: float


def planar_poses(lens: CameraModel, points: Array, pixels: Array, sigma: float) -> list[PoseFit]:
    """Both poses of one plane, best first; points (n, 3) with z = 0, pixels (n, 2) raw.

    z points away from whoever sees the plane's front: what fits from behind alone, as a mirrored
    order of the corners does, is left out. An empty list where fewer than four corners are seen or
    they lie on a line.
    """
    rotation, translation, rms = np.empty((2, 3, 3)), np.empty((2, 3)), np.empty(2)
    count = _PLANE(
        lens.parameters,
        np.ascontiguousarray(points),
        np.ascontiguousarray(pixels),
        sigma,
        *(rotation, translation, rms),
    )
    return [PoseFit(Pose(rotation[i], translation[i]), float(rms[i])) for i in range(count)]
