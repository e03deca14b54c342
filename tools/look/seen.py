"""What one picture shows of a target, in numbers that a person can act upon."""

import math
from collections.abc import Sequence

import cv2
import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.base.clock import to_seconds
from trigpoint.contract.messages import FaceSighting
from trigpoint.edge.registration.blur import Blur
from trigpoint.edge.registration.measurement import Located
from trigpoint.geometry.rotation import Array

# From a tenth to nine tenths of an edge's step, in standard deviations of a Gaussian point spread.
_EDGE_SIGMAS = 2.56
_SHARP_PX = 3.0
"""A wider edge is soft: a sharp lens's and the pixel's own width make 1.5."""
_MOST_PX = 0.99 * _EDGE_SIGMAS * math.sqrt(3.0)
"""Wider ones the core does not measure (`MOST_VARIANCE`, native/src/registration/blur.hpp)."""
_ONE_WAY = 2.0
"""Edges so many times wider along one direction than across it are of motion, not of focus."""
# Motion between pictures farther apart says nothing of that within one.
_LONGEST_GAP_S = 0.5
READOUT_S = 1 / 30
"""How long a rolling shutter takes at most for a picture, whose rows it exposes in turn."""
MOST_BEND = 5e-4
"""A face that moves is bent by a rolling shutter: by more than this share of the picture's diagonal
it tells a wrong lens. It is half of what may be left where a model explains the views at all."""


class Seen(Struct, frozen=True):
    """One face. `square_px`: side of a square, in the middle; `sigma_px`: of a corner's coordinate;
    `edge_px`, `across_px`: width of an edge where it is widest and narrowest; `speed_px`: how fast
    it moves, pixels a second, 0 where that is not known; `bend_px`: what a rolling shutter may make
    of that."""

    sighting: FaceSighting
    name: str
    square_px: float
    edge_px: float
    across_px: float
    speed_px: float = 0.0
    bend_px: float = 0.0

    @property
    def corners(self) -> int:
        return len(self.sighting.corners)

    @property
    def sigma_px(self) -> float:
        return self.sighting.sigma

    @property
    def sharpness(self) -> str:
        """The width of edges in words, with what to do where they are not sharp."""
        if self.edge_px == 0:
            return "sharp, and sharpened by the camera"
        width = f"{self.edge_px:.1f} px wide"
        if self.edge_px <= _SHARP_PX:
            return f"{width}, sharp"
        degree = "soft"
        if self.edge_px >= _MOST_PX:
            width, degree = f"{width} or more", "blurred"
        if self.edge_px > _ONE_WAY * self.across_px:
            return f"{width}, {degree} by motion: hold it still, or expose for a shorter time"
        return f"{width}, {degree}: see to the lens's focus, or clean it"


class Watch:
    """Measures the faces of one camera's pictures in order; one instance per thread."""

    def __init__(self) -> None:
        self._before: list[Seen] = []
        self._before_ns = 0

    def seen(self, faces: Sequence[Located], stamp_ns: int, height: int) -> tuple[Seen, ...]:
        """What a picture of so many rows shows, the face with the most corners first."""
        gap_s = to_seconds(stamp_ns - self._before_ns)
        found = [self._with_motion(_measured(face), gap_s, height) for face in faces]
        found.sort(key=lambda one: -one.corners)
        self._before, self._before_ns = found, stamp_ns
        return tuple(found)

    def _with_motion(self, seen: Seen, gap_s: float, height: int) -> Seen:
        if not 0 < gap_s <= _LONGEST_GAP_S:
            return seen
        ways = [way for other in self._before if (way := _way(other, seen)) is not None]
        if not ways:
            return seen
        speed = min(ways) / gap_s
        share = float(np.ptp(seen.sighting.pixels[:, 1])) / height
        return replace(seen, speed_px=speed, bend_px=speed * READOUT_S * share)


def area_px(pixels: Array) -> float:
    """The area that corners (n, 2) span, pixel²."""
    return float(cv2.contourArea(cv2.convexHull(pixels.astype(np.float32))))


def _measured(located: Located) -> Seen:
    face, found = located.look.face, located.found
    middle = face.corners[found.corners, :2].mean(axis=0)
    square = middle + face.square / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    side = math.sqrt(area_px(found.fit.project(square)))
    edge, across = _edges(found.blur)
    return Seen(located.sighting, located.look.words, side, edge, across)


def _edges(blur: Blur) -> tuple[float, float]:
    """The widths of edges, the wider first, pixels; 0 where the camera sharpens."""
    xx, yy, xy = blur.variances
    across, along = np.linalg.eigvalsh(np.array([[xx, xy], [xy, yy]]))
    return tuple(_EDGE_SIGMAS * math.sqrt(max(float(one), 0.0)) for one in (along, across))  # pyright: ignore


def _way(before: Seen, now: Seen) -> float | None:
    """How far the corners went that both have, median, pixels; None where they are not one face."""
    old, new = before.sighting, now.sighting
    if (old.target, old.face) != (new.target, new.face):
        return None
    _, own, others = np.intersect1d(new.corners, old.corners, return_indices=True)
    if len(own) == 0:
        return None
    ways = new.pixels[own].astype(float) - old.pixels[others]
    return float(np.median(np.linalg.norm(ways, axis=1)))
