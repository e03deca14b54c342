"""Observations that can be read in one way only, many at once: whether a camera could have made
them from where it is thought to be."""

import numpy as np

from trigpoint.fusion.model.observations import Observation
from trigpoint.fusion.model.rolling_shutter import joined
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.target import Target

from .visibility import are_seen, body_of, corners_in_base

_NEAREST_M = 1e-3


def is_unambiguous(observation: Observation) -> bool:
    """Whether each view has exactly one reading."""
    return all(len(view.readings) == 1 for view in observation.views)


def are_visible(
    observations: list[Observation], target: Target, camera_from_base: Pose
) -> np.ndarray:
    """Whether unambiguous observations (n) of one robot, each from its own pose (n), show faces
    that lie before the camera, from in front and past all others, (n,) bool.

    It is what `faces.best_reading` asks of a reading beyond how well it fits.
    """
    body = body_of(target)
    views = [view for observation in observations for view in observation.views]
    owner = np.repeat(np.arange(len(observations)), [len(o.views) for o in observations])
    faces = np.array([view.readings[0].face for view in views])
    is_turned = np.array([view.readings[0].is_turned for view in views])
    sizes = np.array([len(view.corners) for view in views])
    starts = np.cumsum(sizes) - sizes
    corners = np.concatenate([view.corners for view in views])
    points = corners_in_base(body, corners, np.repeat(faces, sizes), np.repeat(is_turned, sizes))
    sweep = joined(views)
    if sweep is not None:
        points = points + sweep.shift(points)
    pose = camera_from_base[np.repeat(owner, sizes)]
    depth = np.sum(pose.rotation[:, 2] * points, axis=1) + pose.translation[:, 2]
    is_good = np.logical_and.reduceat(depth > _NEAREST_M, starts)
    few, is_first = _outermost(np.concatenate([view.pixels for view in views]), sizes)
    eyes = camera_from_base.inverse().translation[owner]
    is_good &= are_seen(body, faces, points[few], is_first, eyes)
    return np.bincount(owner[is_good], minlength=len(observations)) == np.bincount(owner)


def _outermost(pixels: Array, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`visibility.outermost` of many views, whose pixels (n, 2) follow each other by their sizes
    (v,): indices (v, 4) into the pixels, and which of them (v, 4) are not there already."""
    starts = np.cumsum(sizes) - sizes
    rows = np.repeat(np.arange(len(sizes)), sizes)
    columns = np.arange(len(pixels)) - starts[rows]
    found = []
    for reach in (pixels[:, 0] + pixels[:, 1], pixels[:, 0] - pixels[:, 1]):
        for sign in (1, -1):
            table = np.full((len(sizes), sizes.max()), np.inf)
            table[rows, columns] = sign * reach
            found.append(starts + np.argmin(table, axis=1))
    few = np.sort(np.stack(found, axis=1), axis=1)
    return few, np.diff(few, axis=1, prepend=-1) > 0
