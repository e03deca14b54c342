"""How well views are read, each with the target at its assumed pose."""

from collections.abc import Sequence

import numpy as np

from trigpoint.fusion.model.observations import Reading, View
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In, Kernel, Out
from trigpoint.site.target import Target

from .views import BODY, VIEWS, body_tables, view_tables

_READINGS = Kernel(
    "tp_readings",
    *(In(np.float64, ("p",)), *BODY, *VIEWS, In(np.float64, ("views", 12))),
    *(Out(np.int64, ("views",)), Out(np.float64, ("readings",))),
)


def readings_rms_px(
    views: Sequence[View], target: Target, lens: CameraModel, camera_from_base: Pose
) -> tuple[np.ndarray, Array]:
    """For views (v) of one target, each at its own pose (v): the number of the reading of least
    reprojection RMS (v,), and that RMS of a coordinate for every reading of every view, pixels,
    concatenated; infinite for a face that would be seen from behind or through another."""
    tables = view_tables(views)
    numbers, rms = np.empty(len(views), dtype=np.int64), np.empty(len(tables[-1]))
    _READINGS(lens.parameters, *body_tables(target), *tables, camera_from_base.rows(), numbers, rms)
    return numbers, rms


def best_readings(
    views: Sequence[View], target: Target, lens: CameraModel, camera_from_base: Pose
) -> tuple[list[Reading], Array]:
    """The reading of least RMS of views (v) of one target, each for its own pose (v), and that RMS
    (v,), pixels; infinite where no reading can be seen."""
    numbers, rms = readings_rms_px(views, target, lens, camera_from_base)
    counts = np.array([len(view.readings) for view in views], dtype=int)
    least = rms[np.cumsum(counts) - counts + numbers]
    return [view.readings[n] for view, n in zip(views, numbers.tolist(), strict=True)], least


def groups_of(keys: Sequence[object]) -> list[np.ndarray]:
    """The rows that share a key, with the keys in the order in which they first occur."""
    found: dict[object, list[int]] = {}
    for row, key in enumerate(keys):
        found.setdefault(key, []).append(row)
    return [np.array(rows) for rows in found.values()]
