"""A camera's own unknowns: its lens and clock where they are estimated, in this order."""

import numpy as np

from trigpoint.fusion.model.assembly import lens_sigmas
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.problem import CameraState
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from .linear import HELD

# As in the problem (`native/src/fusion/problem.cpp`).
_LEAST_FOCAL_PX = 1.0


def own_prior(data: DataSet, camera: str) -> tuple[Array, Array]:
    """Return the prior means (o,) and sigmas (o,) of a camera's own unknowns."""
    config, lens = data.site.cameras[camera], data.lenses[camera]
    mean, sigma = np.zeros(0), np.zeros(0)
    if config.estimates_intrinsics:
        mean, sigma = lens.parameters, lens_sigmas(config, lens)
    if config.time_offset_sigma > 0:
        mean = np.concatenate([mean, np.zeros(2)])
        drift = max(config.time_drift_sigma, HELD)
        sigma = np.concatenate([sigma, [config.time_offset_sigma, drift]])
    return mean, np.where(sigma > 0, sigma, HELD)


def own_values(data: DataSet, name: str, camera: CameraState) -> Array:
    """Return the values (o,) of these unknowns of a camera."""
    config = data.site.cameras[name]
    values = camera.lens.parameters if config.estimates_intrinsics else np.zeros(0)
    return np.concatenate([values, camera.clock if config.time_offset_sigma > 0 else ()])


def camera_with(data: DataSet, name: str, own: Array) -> CameraState:
    """Return a camera, at the origin, with these values (o,) of them."""
    config, lens = data.site.cameras[name], data.lenses[name]
    if config.estimates_intrinsics:
        parameters = own[: len(lens.parameters)].copy()
        parameters[:2] = np.maximum(parameters[:2], _LEAST_FOCAL_PX)
        lens = lens.with_parameters(parameters)
    clock = own[-2:].tolist() if config.time_offset_sigma > 0 else ()
    return CameraState(Pose.identity(), lens, *clock)
