"""From metres in the map to a drawing of it from above, and marks that maps share."""

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


def suggestion_mark(map_from_base: Pose, plan: Plan, *, number: str = "") -> str:
    """A disc, numbered, with a nose that points where the robot should."""
    place = map_from_base.translation[:2]
    x, y = plan(place)
    nose = np.array([[17.0, 0.0], [6.0, 6.5], [6.0, -6.5]]) / plan.scale
    parts = [polygon(plan(nose @ map_from_base.rotation[:2, :2].T + place), class_="next")]
    parts.append(circle(x, y, 9, class_="next"))
    if number:
        parts.append(text(x, y + 4.5, number, class_="next-text"))
    return group(*parts)
