"""What views tell of a lens: information, covariance, and which views to take.

A view's information about the lens is that of its corners with its pose eliminated (the Schur
complement of the normal equations; Triggs et al., «Bundle Adjustment: A Modern Synthesis», 2000).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array

from .calibration_fit import Fit, pose_jacobian
from .calibration_views import View

_PRIOR = 1e-6
_LEAST = 1e-15


@dataclass(frozen=True, slots=True, eq=False)
class Knowledge:
    """How well a fit knows its lens. `sigma`: of the camera's `parameters`, (p,).

    `noise_px`: of one coordinate, from the residuals. `disagreement`: by how much views differ more
    than corners scatter (1: not at all; a bent board makes it 2 or 3); `sigma` is with it.
    """

    sigma: Array
    noise_px: float
    disagreement: float


def view_information(camera: CameraModel, pose: Pose, view: View) -> Array:
    """Information about `camera.parameters` for corners of 1 px, (p, p)."""
    return _without_pose(*pose_jacobian(camera, pose, view))[0]


def knowledge(found: Fit, views: Sequence[View]) -> Knowledge:
    """Sigmas of a fit. Raises ValueError where the views leave the lens undetermined."""
    parts = [
        _without_pose(*pose_jacobian(found.camera, pose, view), error.reshape(-1))
        for pose, view, error in zip(found.camera_from_face, views, found.errors, strict=True)
    ]
    information = np.array([part[0] for part in parts])
    pulls = np.array([part[1] for part in parts])
    count = information.shape[1]
    errors = np.concatenate([error.reshape(-1) for error in found.errors])
    freedom = len(errors) - 6 * len(views) - count
    if freedom <= 0:
        raise ValueError("there are fewer corners than unknowns")
    noise = np.sqrt(np.sum(errors**2) / freedom)
    covariance = _inverse(information.sum(axis=0))
    disagreement = _disagreement(information, pulls / noise, covariance)
    sigma = disagreement * noise * np.sqrt(np.diag(covariance))
    return Knowledge(sigma, float(noise), disagreement)


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


def _without_pose(
    by_pose: Array, by_parameters: Array, error: Array | None = None
) -> tuple[Array, Array]:
    """Information of the parameters (p, p) and pull of the errors on them (p,), pose eliminated."""
    basis, _ = np.linalg.qr(by_pose)
    free = by_parameters - basis @ (basis.T @ by_parameters)
    pull = free.T @ error if error is not None else np.zeros(free.shape[1])
    return free.T @ free, pull


def _disagreement(information: Array, pulls: Array, covariance: Array) -> float:
    """How much stronger the views pull apart than their corners' scatter (`pulls` in its units)
    lets them, on average over all parameters; never below 1.

    Under white noise view v's pull has the covariance I_v − I_v C I_v: it has pulled the solution
    towards itself (the correction that makes cluster-robust covariances unbiased; Bell and
    McCaffrey, 2002).
    """
    own = information @ covariance
    expected = len(covariance) - float(np.einsum("vij,vji->", own, own))
    if expected < 1:
        return 1.0
    found = float(np.einsum("vi,ij,vj->", pulls, covariance, pulls))
    return float(np.sqrt(max(1.0, found / expected)))


def _inverse(information: Array) -> Array:
    """The inverse, large but finite where coefficients can stand in for each other, as those of the
    rational model do on a lens that needs few of them."""
    scale = 1 / np.sqrt(np.diag(information))
    if not np.all(np.isfinite(scale)):
        raise ValueError("the views do not determine the lens")
    values, vectors = np.linalg.eigh(information * scale[:, None] * scale)
    inverse = (vectors / np.maximum(values, _LEAST * values[-1])) @ vectors.T
    return inverse * scale[:, None] * scale
