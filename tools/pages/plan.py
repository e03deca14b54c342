"""From metres in the map to a drawing of it from above, and marks that maps share."""

from collections.abc import Sequence

import numpy as np

from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from .svg import circle, group, polygon, text

MARGIN = 26.0


class Plan:
    """From metres in the map to the drawing. The long side of the rooms lies across the drawing, or
    down it where `upright`."""

    def __init__(self, everything: Array, width: float, *, upright: bool) -> None:
        """`everything`: (n, 2), the points that must lie in the drawing."""
        low, high = everything.min(axis=0), everything.max(axis=0)
        size = high - low
        # Turned by a quarter where that brings the long side to where it is wanted.
        self._is_turned = bool((size[1] > size[0]) != upright)
        across = size[1] if self._is_turned else size[0]
        down = size[0] if self._is_turned else size[1]
        self.scale = (width - 2 * MARGIN) / across
        self.width, self.height = width, down * self.scale + 2 * MARGIN
        self._low, self._high = low, high

    def __call__(self, points: Array) -> Array:
        """Points (…, 2) of the map in the drawing."""
        corner = [self._low[0], self._low[1]] if self._is_turned else [self._low[0], self._high[1]]
        return self.turned(np.asarray(points, dtype=float) - corner) * self.scale + MARGIN

    def turned(self, vectors: Array) -> Array:
        """Directions (…, 2) of the map in the drawing, whose y points down; their lengths stay."""
        x, y = np.moveaxis(np.asarray(vectors, dtype=float), -1, 0)
        return np.stack([y, x] if self._is_turned else [x, -y], axis=-1)


_MARK_PX = 9


def suggestion_marks(poses: Sequence[Pose], plan: Plan) -> list[str]:
    """Discs, numbered where they are several, with a nose for each way to look there; one for
    places that would lie on each other."""
    groups: list[list[int]] = []
    places = [plan(pose.translation[:2]) for pose in poses]
    for i, place in enumerate(places):
        near = (g for g in groups if np.linalg.norm(places[g[0]] - place) < 2 * _MARK_PX)
        group_of = next(near, None)
        groups.append([i]) if group_of is None else group_of.append(i)
    marks = []
    for members in groups:
        numbers = ", ".join(str(i + 1) for i in members) if len(poses) > 1 else ""
        marks.append(_mark([poses[i] for i in members], plan, numbers))
    return marks


def _mark(poses: Sequence[Pose], plan: Plan, numbers: str) -> str:
    place = poses[0].translation[:2]
    x, y = plan(place)
    radius = max(_MARK_PX, 4 + 3 * len(numbers))
    nose = np.array([[radius + 8.0, 0.0], [radius - 3.0, 6.5], [radius - 3.0, -6.5]])
    parts = [
        polygon(plan(nose / plan.scale @ pose.rotation[:2, :2].T + place), class_="next")
        for pose in poses
    ]
    parts.append(circle(x, y, radius, class_="next"))
    if numbers:
        parts.append(text(x, y + 4.5, numbers, class_="next-text"))
    return group(*parts)
