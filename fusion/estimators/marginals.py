"""Poses and marginal covariances of the cameras, from a filter."""

import numpy as np

from trigpoint.fusion.solver.filter import Filter, is_placed
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from .interface import CameraEstimate


def camera_estimates(
    known: Filter, names: list[str], *, since_epoch_s: float = 0.0
) -> dict[str, CameraEstimate]:
    """The estimates of those of the named cameras that are located, in this order; with their time
    offsets at `since_epoch_s` after the data set's epoch."""
    located, covariances = _placed(known, names)
    if not located:
        return {}
    step = known.known.mean
    disturbances = np.stack([step[known.layout.pose[name]] for name in located])
    poses = Pose.stack([known.state.cameras[name].map_from_camera for name in located])
    moved = poses.disturbed(disturbances)
    return {
        name: _estimate(known, name, moved[row], covariances[row], since_epoch_s)
        for row, name in enumerate(located)
    }


def _placed(known: Filter, names: list[str]) -> tuple[list[str], Array]:
    """The located ones of some cameras, and the covariance (n, 6, 6) of each."""
    here = [name for name in names if known.has_camera(name)]
    if not here:
        return [], np.zeros((0, 6, 6))
    covariances = known.known.blocks(np.stack([known.layout.pose[name] for name in here]))
    kept = [row for row in range(len(here)) if is_placed(covariances[row])]
    return [here[row] for row in kept], covariances[kept]


def _estimate(
    known: Filter, name: str, pose: Pose, covariance: Array, since_epoch_s: float
) -> CameraEstimate:
    camera = known.state.cameras[name]
    lens, lens_sigma = camera.lens, np.zeros(len(camera.lens.parameters))
    if name in known.layout.lens:
        step, spread = _of_part(known, known.layout.lens[name])
        lens_sigma = np.sqrt(np.diagonal(spread))
        lens = lens.with_parameters(lens.parameters + step)
    offset, offset_sigma = float(camera.offset_s(np.array(since_epoch_s))), 0.0
    if name in known.layout.time_offset:
        by_drift = np.array([1.0, since_epoch_s])
        step, spread = _of_part(known, known.layout.time_offset[name])
        offset += float(by_drift @ step)
        offset_sigma = float(np.sqrt(by_drift @ spread @ by_drift))
    return CameraEstimate(pose, covariance, lens, lens_sigma, offset, offset_sigma)


def _of_part(known: Filter, columns: np.ndarray) -> tuple[Array, Array]:
    """Step and covariance of a part of the state."""
    return known.known.mean[columns], known.known.covariance_of(columns)


def joint_covariance(known: Filter, names: list[str]) -> Array:
    """(6n, 6n) over the poses of those of the named cameras that are located, in this order."""
    located, _ = _placed(known, names)
    if not located:
        return np.zeros((0, 0))
    chosen = np.concatenate([known.layout.pose[name] for name in located])
    return known.known.covariance[np.ix_(chosen, chosen)]
