"""What views tell of a lens: their information, and which of them to take.

A view's information about the lens is that of its corners with its pose eliminated (the Schur
complement of the normal equations; Triggs et al., «Bundle Adjustment: A Modern Synthesis», 2000).
"""

from collections.abc import Sequence

import numpy as np

from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array

from .calibration_fit import pose_jacobian
from .calibration_views import View

_PRIOR = 1e-6


def view_information(camera: CameraModel, pose: Pose, view: View) -> Array:
    """Information about `camera.parameters` for corners of 1 px, (p, p)."""
    return without_pose(*pose_jacobian(camera, pose, view))[0]


def most_informative(
    information: Sequence[Array], *, fewest: int, most: int, gain: float
) -> list[int]:
    """Views by the order in which each tells most beyond the ones before it (greedy, by the
    determinant of the sum). Ends at `most`, or beyond `fewest` where a view would make the average
    sigma smaller by less than the share `gain`; `information`: (p, p) each, in any unit.
    """
    matrices = np.array(information)
    scale = 1 / np.sqrt(np.maximum(np.einsum("vii->i", matrices), 1e-300))
    matrices = matrices * scale[:, None] * scale  # so that the prior weighs on all alike
    count = matrices.shape[1]
    total = _PRIOR * np.eye(count)
    chosen, left = [], list(range(len(matrices)))
    while left and len(chosen) < most:
        grown = np.linalg.slogdet(total + matrices[left])[1] - np.linalg.slogdet(total)[1]
        best = int(np.argmax(grown))
        if grown[best] < 2 * count * gain and len(chosen) >= fewest:
            break
        chosen.append(left.pop(best))
        total = total + matrices[chosen[-1]]
    return chosen


def without_pose(
    by_pose: Array, by_parameters: Array, error: Array | None = None
) -> tuple[Array, Array]:
    """Information of the parameters (p, p) and pull of the errors on them (p,), pose eliminated."""
    basis, _ = np.linalg.qr(by_pose)
    free = by_parameters - basis @ (basis.T @ by_parameters)
    pull = free.T @ error if error is not None else np.zeros(free.shape[1])
    return free.T @ free, pull
