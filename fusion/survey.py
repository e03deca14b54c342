"""What a filter knows of the cameras, in the form in which it is given out."""

import numpy as np

from trigpoint.geometry.rotation import Array

from .estimator import CameraEstimate
from .filter import Filter
from .problem import Layout

# A pose with a larger sigma is none: behind a jump of the odometry nothing ties it to the map.
_LOOSE_M = 20.0
_LOOSE_RAD = 1.0


def is_placed(covariance: Array) -> bool:
    """Whether a pose with this covariance (6, 6) is known well enough to be one."""
    return bool(
        np.trace(covariance[:3, :3]) < _LOOSE_M**2 and np.trace(covariance[3:, 3:]) < _LOOSE_RAD**2
    )


def camera_estimates(
    known: Filter, names: list[str], *, since_epoch_s: float = 0.0
) -> dict[str, CameraEstimate]:
    """Those of the named cameras that are located, in this order; with their time offsets at that
    time after the data set's epoch."""
    layout = known.layout
    covariance, step = known.known.covariance, known.known.mean
    located = _placed(layout, covariance, names)
    return {name: _estimate(known, name, covariance, step, since_epoch_s) for name in located}


def _placed(layout: Layout, covariance: Array, names: list[str]) -> list[str]:
    return [
        name
        for name in names
        if name in layout.pose and is_placed(covariance[layout.pose[name], layout.pose[name]])
    ]


def _estimate(
    known: Filter, name: str, covariance: Array, step: Array, since_epoch_s: float
) -> CameraEstimate:
    layout, camera = known.layout, known.state.cameras[name]
    pose, sigmas = layout.pose[name], np.sqrt(np.diagonal(covariance))
    lens, lens_sigma = camera.lens, np.zeros(len(camera.lens.parameters))
    if name in layout.lens:
        lens_sigma = sigmas[layout.lens[name]]
        lens = lens.with_parameters(lens.parameters + step[layout.lens[name]])
    offset, offset_sigma = float(camera.offset_s(np.array(since_epoch_s))), 0.0
    if name in layout.time_offset:
        columns, by_drift = layout.time_offset[name], np.array([1.0, since_epoch_s])
        offset += float(by_drift @ step[columns])
        offset_sigma = float(np.sqrt(by_drift @ covariance[columns, columns] @ by_drift))
    return CameraEstimate(
        camera.map_from_camera.disturbed(step[pose]),
        covariance[pose, pose],
        lens,
        lens_sigma,
        offset,
        offset_sigma,
    )


def joint_covariance(known: Filter, names: list[str]) -> Array:
    """(6n, 6n) over the poses of those of the named cameras that are located, in this order."""
    layout, covariance = known.layout, known.known.covariance
    every = np.arange(layout.size)
    columns = [every[layout.pose[name]] for name in _placed(layout, covariance, names)]
    if not columns:
        return np.zeros((0, 0))
    chosen = np.concatenate(columns)
    return covariance[np.ix_(chosen, chosen)]
