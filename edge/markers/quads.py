"""Finds dark quadrilaterals, which markers are, whatever dictionary they are from."""

import cv2
import numpy as np

from trigpoint.edge.image.region import Region
from trigpoint.edge.image.time_limit import IsOver, never
from trigpoint.edge.image.workspace import Workspace
from trigpoint.geometry.rotation import Array

from .quad_edges import straightened

# Small markers are looked for in the picture, large ones and blurred ones at half its size: how
# many times smaller, and the threshold's window there, pixels. On rendered moving targets the two
# find as many markers as windows of 5 and 21 in the whole picture, at half the time.
_PASSES = ((1, 5), (2, 11))
# A picture whose longer side is of more pixels is looked at so many times smaller that it is not:
# twelve megapixels hold no detail of one pixel, and markers that are read have ten.
_MOST_SIDE_PX = 2560
# How much darker than its surroundings a pixel must be, grey levels.
_DARKER = 7
# Of the picture's longer side; OpenCV's 0.03 loses markers of 4 pixels that still can be read.
_LEAST_PERIMETER = 0.02
# Of the perimeter: how far a marker's edge may be from straight, and how short a side may be.
_POLYGON_ACCURACY = 0.05
_LEAST_SIDE = 0.05
_MARGIN_PX = 2
# Quadrilaterals whose places and sizes differ by less of their size are one.
_SAME_SHARE = 0.2
# What a pixel of light spreads to, where dark pieces are to be parted.
_AROUND = np.ones((3, 3), np.uint8)
# How many dark pieces a threshold may leave, by the beginnings of dark runs in rows, and how many
# of them are looked at, in each pass. Pictures of rooms have up to 12 000 and 150; noise and
# chequered walls have 100 000 and 6000, over which OpenCV would take 50 ms.
MOST_RUNS = 30_000
MOST_PIECES = 800


class QuadFinder:
    """Thresholds a picture and looks at the outlines of dark pieces; for one thread.

    `parts_touching`: pieces that touch with their corners are parted, by a pixel of light.
    """

    def __init__(self, *, parts_touching: bool = False) -> None:
        self._space = Workspace()
        self._parts_touching = parts_touching

    def find(
        self, grey: np.ndarray, is_over: IsOver = never, within: Region | None = None
    ) -> Array:
        """Corners (n, 4, 2) of the dark quadrilaterals, clockwise from any of the four, pixels;
        `within` a region only those that show at the picture's own size.

        Nothing is looked for where the picture is too crowded.
        """
        passes = _PASSES[:1] if within else _PASSES
        within = within or Region.whole(grey)
        part, found = within.of(grey), np.zeros((0, 4, 2))
        base = -(-max(grey.shape) // _MOST_SIDE_PX)
        for times, window_px in passes:
            step = base * times
            size = (part.shape[1] // step, part.shape[0] // step)
            if min(size) < 2 * window_px or is_over():
                break
            small = part
            if step > 1:
                small = self._space.array(f"small {step}", size[::-1], np.uint8)
                whole = part[: step * size[1], : step * size[0]]
                cv2.resize(whole, size, dst=small, interpolation=cv2.INTER_AREA)
            least = _LEAST_PERIMETER * (max(grey.shape) // step)
            more = step * self._outlines(small, times, window_px, least) + (step - 1) / 2
            found = np.concatenate([found, more[~_are_among(more, found)]])
        return straightened(grey, found + within.corner)

    def _outlines(self, grey: np.ndarray, step: int, window_px: int, least: float) -> Array:
        """The quadrilaterals (n, 4, 2) of one pass, its pixels, of at least such a perimeter."""
        dark = self._space.array(f"dark {step}", grey.shape, np.uint8)
        shown = grey
        if self._parts_touching:
            shown = self._space.array(f"parted {step}", grey.shape, np.uint8)
            cv2.dilate(grey, _AROUND, dst=shown)
        cv2.adaptiveThreshold(
            shown,
            255,
            cv2.ADAPTIVE_THRESH_MEAN_C,
            cv2.THRESH_BINARY_INV,
            window_px,
            _DARKER,
            dst=dark,
        )
        if dark_runs(dark, self._space.array(f"begins {step}", grey.shape, np.uint8)) > MOST_RUNS:
            return np.zeros((0, 4, 2))
        pieces = _outer_contours(dark, least)
        quads = [quad for piece in pieces if (quad := _quad_of(piece)) is not None]
        whole = _whole(_clockwise(np.array(quads, dtype=float).reshape(-1, 4, 2)), grey.shape)
        return straightened(grey, whole) if self._parts_touching else whole


def dark_runs(dark: np.ndarray, scratch: np.ndarray) -> int:
    """How many times a dark run begins in the rows of a threshold (h, w); `scratch`: the same
    size."""
    begins = cv2.compare(dark[:, 1:], dark[:, :-1], cv2.CMP_GT, dst=scratch[:, 1:])
    return cv2.countNonZero(begins)


def _outer_contours(dark: np.ndarray, least: float) -> list[np.ndarray]:
    """Outlines of dark pieces, no holes, of at least so many pixels; the longest MOST_PIECES."""
    contours, hierarchy = cv2.findContours(dark, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    if not contours:
        return []
    lengths = np.fromiter(map(len, contours), int, len(contours))
    is_outer = np.asarray(hierarchy).reshape(-1, 4)[:, 3] < 0
    usable = np.flatnonzero(is_outer & (lengths >= least))
    if len(usable) > MOST_PIECES:
        usable = usable[np.argsort(-lengths[usable], kind="stable")[:MOST_PIECES]]
    return [contours[index] for index in usable.tolist()]


def _quad_of(contour: np.ndarray) -> np.ndarray | None:
    """The convex quadrilateral (4, 1, 2) that a contour is, if it is one."""
    quad = cv2.approxPolyDP(contour, _POLYGON_ACCURACY * len(contour), True)
    return quad if len(quad) == 4 and cv2.isContourConvex(quad) else None


def _are_among(quads: Array, others: Array) -> np.ndarray:
    """Which quads (n, 4, 2) are about the same as one of the others; (n,) bool."""
    size, other_size = (np.ptp(some, axis=1).max(axis=1, initial=0) for some in (quads, others))
    middles, other_middles = quads.mean(axis=1), others.mean(axis=1)
    # One number at a time: a crowd makes 800 by 800 pairs, whose reduction over (x, y) is slow.
    apart = np.abs(size[:, None] - other_size)
    for axis in (0, 1):
        aside = middles[:, axis, None] - other_middles[:, axis]
        np.maximum(apart, np.abs(aside, out=aside), out=apart)
    return np.any(apart < _SAME_SHARE * size[:, None], axis=1)


def _clockwise(quads: Array) -> Array:
    """The quads (n, 4, 2) with corners in the order that is clockwise in a picture."""
    a, b = quads[:, 1] - quads[:, 0], quads[:, 2] - quads[:, 0]
    turns_back = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0] < 0
    return np.where(turns_back[:, None, None], quads[:, ::-1], quads)


def _whole(quads: Array, shape: tuple[int, ...]) -> Array:
    """The quads (n, 4, 2) that have four sides and keep off the picture's edge."""
    limit = np.array(shape[::-1]) - 1 - _MARGIN_PX
    sides = np.abs(quads - np.roll(quads, 1, axis=1)).max(axis=2)
    is_whole = sides.min(axis=1) >= _LEAST_SIDE * sides.sum(axis=1)
    return quads[is_whole & np.all((quads >= _MARGIN_PX) & (quads <= limit), axis=(1, 2))]


def square_to_quads(quads: Array) -> Array:
    """Homographies (n, 3, 3) from the unit square (0, 0), (1, 0), (1, 1), (0, 1) to the quads.

    Closed form: Heckbert, «Fundamentals of texture mapping and image warping» (1989), 2.2.3.
    """
    a, b, c, d = np.moveaxis(quads, 1, 0)
    bend, right, down = a - b + c - d, b - c, d - c
    determinant = right[:, 0] * down[:, 1] - right[:, 1] * down[:, 0]
    safe = np.where(np.abs(determinant) > 1e-9, determinant, 1e-9)
    g = (bend[:, 0] * down[:, 1] - bend[:, 1] * down[:, 0]) / safe
    h = (right[:, 0] * bend[:, 1] - right[:, 1] * bend[:, 0]) / safe
    maps = np.empty((len(quads), 3, 3))
    maps[:, :2, 0] = b - a + g[:, None] * b
    maps[:, :2, 1] = d - a + h[:, None] * d
    maps[:, :2, 2] = a
    maps[:, 2] = np.stack([g, h, np.ones_like(g)], axis=-1)
    return maps


def mapped(homographies: Array, points: Array) -> Array:
    """Points (m, 2), or (n, m, 2) for each its own, through n homographies (n, 3, 3): (n, m, 2).

    A point on the horizon comes out far away, never as no number.
    """
    turned = np.swapaxes(homographies, -1, -2)
    flat = points @ turned[:, :2] + turned[:, 2:]
    depth = flat[..., 2:]
    return flat[..., :2] / np.where(np.abs(depth) < 1e-9, 1e-9, depth)
