"""The outline of points in a picture."""

import numpy as np

from trigpoint.geometry.rotation import Array


def outline(points: Array) -> Array:
    """The convex hull of (n, 2) points as a closed line (Andrew's monotone chain)."""
    ordered = sorted(map(tuple, points.tolist()))
    lower, upper = _half_hull(ordered), _half_hull(ordered[::-1])
    hull = [*lower[:-1], *upper[:-1]] or ordered
    return np.array([*hull, hull[0]])


def _half_hull(ordered: list[tuple[float, ...]]) -> list[tuple[float, ...]]:
    hull: list[tuple[float, ...]] = []
    for point in ordered:
        while len(hull) >= 2 and _turn(hull[-2], hull[-1], point) <= 0:
            hull.pop()
        hull.append(point)
    return hull


def _turn(a: tuple[float, ...], b: tuple[float, ...], c: tuple[float, ...]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
