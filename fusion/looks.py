"""How well many camera poses fit many observations, roughly and fast."""

from dataclasses import dataclass

import numpy as np

from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array
from trigpoint.target import Target

from .body import Body, body_of, by_reading, can_be_seen, faces_of, outermost
from .observations import Observation

# What a corner costs at most, pixels: beyond it a view fits not at all.
WORST_PX = 20.0


@dataclass(frozen=True, slots=True)
class _FewCorners:
    """A view at its outermost corners: `points` (r, k, 3) by reading in the base frame, `faces`
    (r,), `pixels` (k, 2)."""

    points: Array
    faces: np.ndarray
    pixels: Array


@dataclass(frozen=True, slots=True)
class Look:
    """An observation made ready for `mean_cost`."""

    map_from_base: Pose
    body: Body
    views: tuple[_FewCorners, ...]


def look_of(observation: Observation, target: Target, map_from_base: Pose) -> Look:
    """A look at an observation, at its outermost corners alone."""
    body, views = body_of(target), []
    for view in observation.views:
        few = outermost(view.pixels)
        views.append(_FewCorners(by_reading(view, body)[:, few], faces_of(view), view.pixels[few]))
    return Look(map_from_base, body, tuple(views))


def mean_cost(map_from_camera: Pose, looks: list[Look], lens: CameraModel) -> Array:
    """How badly camera poses (n) fit many observations: the mean over their views of the least
    mean-square reprojection error, pixels², each capped, (n,)."""
    total, views = np.zeros(len(map_from_camera)), 0
    for look in looks:
        camera_from_base = map_from_camera.inverse() @ look.map_from_base
        for view in look.views:
            views += 1
            total += _least_cost(lens, camera_from_base, look.body, view)
    return total / max(views, 1)


def _least_cost(lens: CameraModel, camera_from_base: Pose, body: Body, view: _FewCorners) -> Array:
    points = view.points.reshape(-1, 3)
    optical = (camera_from_base @ points).reshape(-1, *view.points.shape)
    ahead = np.all(optical[..., 2] > 1e-2, axis=-1)
    projected = lens.project(np.where(optical[..., 2:] > 1e-2, optical, [0.0, 0.0, 1.0]))
    square = np.mean((projected - view.pixels) ** 2, axis=(-1, -2))
    fits = ahead & (square < WORST_PX**2)
    near = np.flatnonzero(fits.any(axis=1))
    if len(near):
        eye = camera_from_base.inverse().translation[near]
        fits[near] &= can_be_seen(body, view.faces, view.points, eye)
    return np.where(fits, square, WORST_PX**2).min(axis=1)
