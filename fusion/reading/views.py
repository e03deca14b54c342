"""A target, and views of it, as the core takes them: `Body` and `Views` of `reading.hpp`."""

from collections.abc import Sequence
from functools import cache

import numpy as np

from trigpoint.fusion.model.observations import View, base_from_faces
from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In
from trigpoint.site.target import Target

_REAL, _WHOLE = np.float64, np.int64
_AT_REST = np.zeros(6)

BODY = (
    *(In(_REAL, ("f", "most", 3)), In(_WHOLE, ("f",))),
    *(In(_REAL, ("f", 12)), In(_REAL, ("f", 4))),
)
VIEWS = (
    *(In(_WHOLE, ("views", 4)), In(_REAL, ("views",)), In(_REAL, ("views", 6))),
    *(In(_WHOLE, ("corners",)), In(_REAL, ("corners", 2)), In(_REAL, ("corners",))),
    In(_WHOLE, ("readings", 2)),
)


@cache
def body_tables(target: Target) -> tuple[np.ndarray, ...]:
    """A target as `BODY`."""
    counts = np.array([face.corner_count for face in target.faces], _WHOLE)
    corners = np.zeros((len(counts), counts.max(), 3))
    for face, row in zip(target.faces, corners, strict=True):
        row[: face.corner_count] = face.corners
    outlines = np.stack([face.outline[:, :2] for face in target.faces])
    ends = np.concatenate([outlines.min(axis=1), outlines.max(axis=1)], axis=1)
    return corners, counts, base_from_faces(target).rows(), ends


@cache
def patterns(target: Target) -> np.ndarray:
    """A number for each face (f,), the same for those of one pattern."""
    kinds = [(face.appearance, face.square, face.marker) for face in target.faces]
    return np.array([kinds.index(kind) for kind in kinds], _WHOLE)


def view_tables(views: Sequence[View]) -> tuple[np.ndarray, ...]:
    """Views of one robot as `VIEWS`."""
    rows = np.empty((len(views), 4), _WHOLE)
    rows[:, 1] = [len(view.corners) for view in views]
    rows[:, 3] = [len(view.readings) for view in views]
    rows[:, 0::2] = np.cumsum(rows[:, 1::2], axis=0) - rows[:, 1::2]
    readings = [(each.face, each.is_turned) for view in views for each in view.readings]
    after_s: list[Array] = [
        np.zeros(len(view.corners)) if view.sweep is None else view.sweep.after_s for view in views
    ]
    twists = [_AT_REST if view.sweep is None else view.sweep.twist for view in views]
    return (
        rows,
        np.array([view.sigma for view in views], _REAL),
        np.array(twists, _REAL).reshape(-1, 6),
        np.concatenate([np.empty(0, _WHOLE), *(view.corners for view in views)]),
        np.concatenate([np.empty((0, 2)), *(view.pixels for view in views)]),
        np.concatenate([np.empty(0), *after_s]),
        np.array(readings, _WHOLE).reshape(-1, 2),
    )
