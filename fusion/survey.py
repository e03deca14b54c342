"""What a filter knows of the cameras, in the form in which it is given out."""

import numpy as np

from trigpoint.geometry.rotation import Array

from .estimator import CameraEstimate
from .filter import Filter


def camera_estimates(known: Filter, names: list[str]) -> dict[str, CameraEstimate]:
    """Those of the named cameras that are located, in this order."""
    layout = known.reduced.layout
    covariance, step = known.reduced.covariance(), known.mean_step()
    located = [name for name in names if name in layout.pose]
    return {name: _estimate(known, name, covariance, step) for name in located}


def _estimate(known: Filter, name: str, covariance: Array, step: Array) -> CameraEstimate:
    layout, camera = known.reduced.layout, known.state.cameras[name]
    pose, sigmas = layout.pose[name], np.sqrt(np.diagonal(covariance))
    lens, lens_sigma = camera.lens, np.zeros(len(camera.lens.parameters))
    if name in layout.lens:
        lens_sigma = sigmas[layout.lens[name]]
        lens = lens.with_parameters(lens.parameters + step[layout.lens[name]])
    offset, offset_sigma = camera.time_offset_s, 0.0
    if name in layout.time_offset:
        offset += float(step[layout.time_offset[name]][0])
        offset_sigma = float(sigmas[layout.time_offset[name]][0])
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
    layout = known.reduced.layout
    every = np.arange(layout.size)
    columns = [every[layout.pose[name]] for name in names if name in layout.pose]
    if not columns:
        return np.zeros((0, 0))
    chosen = np.concatenate(columns)
    return known.reduced.covariance()[np.ix_(chosen, chosen)]
