"""The best readings of many views, each at its assumed pose: `faces.readings_rms_px` for all of
them at once."""

from collections.abc import Sequence

import numpy as np

from trigpoint.fusion.model.observations import Observation, Reading, View, joined
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array
from trigpoint.site.target import Target

from .visibility import Body, are_seen, body_of, corners_in_base, ways_of

_NEAREST_M = 1e-3
# The most corners that are processed at once, over all their readings: some 20 MB.
_MOST_CORNERS = 100_000


def best_readings(
    views: Sequence[View], target: Target, lens: CameraModel, camera_from_base: Pose
) -> tuple[list[Reading], Array]:
    """The reading of least RMS of views (v) of one target, each for its own pose (v), and that RMS
    (v,), pixels; infinite where no reading can be seen."""
    numbers, rms = np.zeros(len(views), dtype=int), np.full(len(views), np.inf)
    for rows in groups_of([(len(view.corners), len(view.readings)) for view in views]):
        corners, readings = len(views[rows[0]].corners), len(views[rows[0]].readings)
        step = max(1, _MOST_CORNERS // max(1, corners * readings))
        for part in (rows[start : start + step] for start in range(0, len(rows), step)):
            some = [views[row] for row in part]
            each = _rms_px(some, body_of(target), lens, camera_from_base[part])
            numbers[part] = np.argmin(each, axis=1)
            rms[part] = each.min(axis=1)
    chosen = [view.readings[number] for view, number in zip(views, numbers, strict=True)]
    return chosen, rms


def read_where_they_are(
    observations: Sequence[Observation], target: Target, lens: CameraModel, camera_from_base: Pose
) -> list[tuple[tuple[Reading, ...], Array]]:
    """The best reading of each view of observations (n) of one robot, each from its own pose (n),
    and their RMS."""
    views = [view for observation in observations for view in observation.views]
    owner = np.repeat(np.arange(len(observations)), [len(o.views) for o in observations])
    chosen, rms = best_readings(views, target, lens, camera_from_base[owner])
    ends = np.cumsum([len(observation.views) for observation in observations])
    starts = [0, *ends[:-1].tolist()]
    return [
        (tuple(chosen[start:end]), rms[start:end])
        for start, end in zip(starts, ends.tolist(), strict=True)
    ]


def groups_of(keys: Sequence[object]) -> list[np.ndarray]:
    """The rows that share a key, with the keys in the order in which they first occur."""
    found: dict[object, list[int]] = {}
    for row, key in enumerate(keys):
        found.setdefault(key, []).append(row)
    return [np.array(rows) for rows in found.values()]


def points_of_views(views: Sequence[View], body: Body, faces: Array, is_turned: Array) -> Array:
    """The corners in the base frame of views (v) with n corners each, for readings (v, r) of each:
    (v, r, n, 3)."""
    corners = np.stack([view.corners for view in views])
    points = corners_in_base(body, corners[:, None], faces[..., None], is_turned[..., None])
    sweep = joined(views)
    if sweep is None:
        return points
    shape = points.swapaxes(0, 1).shape
    shift = sweep.shift(points.swapaxes(0, 1).reshape(shape[0], -1, 3))
    return points + shift.reshape(shape).swapaxes(0, 1)


def _rms_px(views: Sequence[View], body: Body, lens: CameraModel, camera_from_base: Pose) -> Array:
    """`faces.readings_rms_px` of views (v) with equally many corners and readings (r), each for its
    own pose (v): (v, r)."""
    faces, is_turned = (
        np.stack(each) for each in zip(*(ways_of(v.readings) for v in views), strict=True)
    )
    points = points_of_views(views, body, faces, is_turned)
    pixels = np.stack([view.pixels for view in views])
    turned = np.swapaxes(camera_from_base.rotation, 1, 2)[:, None]
    optical = points @ turned + camera_from_base.translation[:, None, None]
    is_ahead = optical[..., 2] > _NEAREST_M
    projected = lens.project(np.where(is_ahead[..., None], optical, [0.0, 0.0, 1.0]))
    rms = np.sqrt(np.mean((projected - pixels[:, None]) ** 2, axis=(-1, -2)))
    few, is_counted = _outermost(pixels)
    outer = np.take_along_axis(points, few[:, None, :, None], axis=2)
    count, readings = faces.shape
    is_seen = are_seen(
        body,
        faces.reshape(-1),
        outer.reshape(count * readings, -1, 3),
        np.repeat(is_counted, readings, axis=0),
        np.repeat(camera_from_base.inverse().translation, readings, axis=0),
    )
    return np.where(is_ahead.all(axis=-1) & is_seen.reshape(count, readings), rms, np.inf)


def _outermost(pixels: Array) -> tuple[np.ndarray, np.ndarray]:
    """`visibility.outermost` of views with pixels (v, n, 2): indices (v, 4) of corners, and which
    of them (v, 4) are no duplicates."""
    rising, falling = pixels[..., 0] + pixels[..., 1], pixels[..., 0] - pixels[..., 1]
    ends = [np.argmin(sign * reach, axis=1) for reach in (rising, falling) for sign in (1, -1)]
    few = np.sort(np.stack(ends, axis=1), axis=1)
    return few, np.diff(few, axis=1, prepend=-1) > 0
