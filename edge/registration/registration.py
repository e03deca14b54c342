"""Measures corners by laying the printed pattern over the picture.

Around each corner the pattern is drawn as the camera must see it: through the face's planar fit, so
in its perspective and lens, and blurred as the picture is (`patches`). What is left between drawing
and picture says how far the corner is off (`alignment`). Next squares and markers are in the
drawing, so they pull at nothing, and blur widens both alike.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from trigpoint.edge.image.median import median
from trigpoint.edge.image.time_limit import IsOver, never
from trigpoint.geometry.rotation import Array

from .alignment import Alignment, Usual, aligned
from .blur import SHARP, Blur
from .patches import MOST_HALF_PX, CornerPattern, patches_around
from .planar_fit import PlanarFit
from .sound_corners import sound_corners

ROUNDS = 6
ROUGH_ROUNDS = 2
# And more, for those corners alone, if few, that have not settled by then: boards curl.
LATE_ROUNDS = 4
MOST_LATE = 8
# By how many corners a face is first brought near.
ROUGH_CORNERS = 16
# By how much a picture is softened where corners are off by more than its own blur, pixel².
SOFTENING = 1.6
# A step is trusted so far, pixels.
LONGEST_STEP_PX = 1.0
LONGEST_ROUGH_STEP_PX = 2.5
# Where most steps are shorter, what is left of them is of no account.
NEAR_STEP_PX = 0.5
# Steps so short change nothing in how corners look.
STILL_STEP_PX = 0.3
# What is left after a step is a fiftieth of it: after such steps, if few corners step further than
# SETTLED_STEP_PX, the face needs no other round. After such far ones it is not near yet.
SMALL_STEP_PX = 0.12
FAR_STEP_PX = 0.6
# Steps that do not become so much shorter lead nowhere: the face is not there.
LEAST_SHORTER = 0.8
# A corner may lie so far beside the middle of its patch, pixels, before another part of the picture
# is taken.
MOST_ASIDE_PX = 0.6
SETTLED_STEP_PX = 0.15
# Of the blur's numbers.
SMALL_CHANGE = 0.1
_AROUND_PX = MOST_HALF_PX + 6


@dataclass(frozen=True, slots=True)
class Registration:
    """Where corners are. `pixels`: (n, 2); `is_clear`: (n,) whether the picture shows the corner as
    the pattern has it, `is_whole`: with nothing before any of it; `sigma`: (n,) of a coordinate by
    the picture's noise, pixels; `blur`: of the picture there; `fit`: the last one used."""

    pixels: Array
    is_clear: np.ndarray
    is_whole: np.ndarray
    sigma: Array
    blur: Blur
    fit: PlanarFit


def registered(
    grey: np.ndarray,
    pattern: CornerPattern,
    fit: PlanarFit,
    ids: np.ndarray,
    *,
    starts: Array | None = None,
    blur: Blur | None = None,
    is_rough: bool = False,
    is_over: IsOver = never,
) -> Registration | None:
    """The corners `ids` (n,) of a face that lies about where `fit` has it: to a pixel or so, or to
    two or three where `is_rough` (then it is brought near by a wider drawing of a few corners).
    `starts`: (n, 2) where corners were found already, to a pixel or so, not a number where not.
    While corners are far, the light counts as even. None where `is_over` becomes true before they
    have settled."""
    blur, is_far = SHARP if blur is None else blur, False
    if is_rough:
        fit, is_far = _approached(grey, pattern, fit, _spread(ids), blur)
        if is_over():
            return None
    face = _Face.at(grey, pattern, ids, fit, blur, starts)
    found = face.moved(is_far=is_far)
    usual, before = _usual_length(found), np.inf
    for _ in range(ROUNDS - 1):
        is_vain = usual > STILL_STEP_PX and usual > LEAST_SHORTER * before
        if (_is_near(found) and not is_far) or is_vain or not found.is_clear.any():
            break
        if is_over():
            return None
        is_far = usual > FAR_STEP_PX
        if usual > STILL_STEP_PX or not found.is_clear.all():
            face.refit(found.is_clear)
        found = face.moved(is_far=is_far)
        usual, before = _usual_length(found), usual
    return face.settled(found)


@dataclass(slots=True, eq=False)
class _Face:
    """What is known of a face between the rounds. `pixels`: (n, 2) where the corners `ids` are;
    `nearest`: (n, 2) the whole pixels about which they are looked at; `starts`: (n, 2) where they
    were found before, not a number where they were not."""

    grey: np.ndarray
    pattern: CornerPattern
    ids: np.ndarray
    fit: PlanarFit
    blur: Blur
    pixels: Array
    nearest: Array
    starts: Array

    @classmethod
    def at(
        cls,
        grey: np.ndarray,
        pattern: CornerPattern,
        ids: np.ndarray,
        fit: PlanarFit,
        blur: Blur,
        starts: Array | None,
    ) -> "_Face":
        """A face that lies where `fit` has it, but for corners that were found further than a step
        from there: within one the fit through all of them knows better."""
        pixels = fit.project(pattern.points[ids])
        starts = np.full(pixels.shape, np.nan) if starts is None else starts
        is_far = np.linalg.norm(starts - pixels, axis=1, keepdims=True) > LONGEST_STEP_PX
        starts = np.where(is_far, starts, np.nan)
        pixels = np.where(is_far, starts, pixels)
        return cls(grey, pattern, ids, fit, blur, pixels, np.rint(pixels), starts)

    def moved(self, *, is_far: bool = False) -> Alignment:
        """A round for all corners: the clear ones are moved, the blur is mended."""
        found = self._aligned(np.arange(len(self.ids)), None, is_far=is_far)
        self.blur = found.blur
        return found

    def refit(self, clear: np.ndarray) -> None:
        """Take the plane through the clear corners, and put the others where they were found, or
        where that has them."""
        size = (self.grey.shape[1], self.grey.shape[0])
        points = self.pattern.points[self.ids]
        self.fit, pixels = _refitted(self.fit, points, self.pixels, clear, size)
        self.pixels = np.where(clear[:, None] | np.isnan(self.starts), pixels, self.starts)

    def settled(self, found: Alignment) -> Registration:
        """What was found, after more rounds for those corners alone that still move."""
        clear, whole, sigma = found.is_clear, found.is_whole, found.sigma
        moves = np.linalg.norm(found.step, axis=1)
        for _ in range(LATE_ROUNDS):
            late = np.flatnonzero(clear & (moves > SETTLED_STEP_PX))
            if not 0 < len(late) <= MOST_LATE:
                break
            again = self._aligned(late, found.usual)
            clear[late], sigma[late] = again.is_clear, again.sigma
            whole[late] = again.is_whole
            moves[late] = np.linalg.norm(again.step, axis=1)
        # A corner that still moves has not found its place.
        clear &= moves <= SETTLED_STEP_PX
        return Registration(self.pixels, clear, whole, sigma, self.blur, self.fit)

    def _aligned(
        self, which: np.ndarray, usual: Usual | None, *, is_far: bool = False
    ) -> Alignment:
        """Moves some of the corners (indices) if they are clear. Each keeps the part of the picture
        that it is looked for in while it lies near its middle: in another one it is found a little
        elsewhere, and would step to and fro."""
        pixels, nearest = self.pixels[which], self.nearest[which]
        nearest = np.where(np.abs(pixels - nearest) > MOST_ASIDE_PX, np.rint(pixels), nearest)
        ids = self.ids[which]
        patches = patches_around(self.grey, self.pattern, self.fit, ids, pixels, nearest)
        found = aligned(
            patches,
            self.blur,
            LONGEST_STEP_PX,
            usual=usual,
            is_light_even=is_far,
            is_balanced=self.pattern.is_balanced,
        )
        self.nearest[which] = nearest
        self.pixels[which] = pixels + np.where(found.is_clear[:, None], found.step, 0.0)
        return found


def _spread(ids: np.ndarray) -> np.ndarray:
    """ROUGH_CORNERS of the corners, or so, from all over the face; the first and the last too."""
    count = min(len(ids), ROUGH_CORNERS)
    return ids[np.linspace(0, len(ids) - 1, count).round().astype(int)]


def _approached(
    grey: np.ndarray, pattern: CornerPattern, fit: PlanarFit, ids: np.ndarray, blur: Blur
) -> tuple[PlanarFit, bool]:
    """A fit that is off by a pixel at most, found in the softened picture, and whether it still is
    far."""
    points, size = pattern.points[ids], (grey.shape[1], grey.shape[0])
    pixels = fit.project(points)
    soft = _softened(grey, pixels)
    for _ in range(ROUGH_ROUNDS):
        patches = patches_around(soft, pattern, fit, ids, pixels, np.rint(pixels))
        soft_blur = blur.softened(SOFTENING)
        found = aligned(
            patches,
            soft_blur,
            LONGEST_ROUGH_STEP_PX,
            is_light_even=True,
            is_balanced=pattern.is_balanced,
        )
        pixels = pixels + np.where(found.is_clear[:, None], found.step, 0.0)
        fit, pixels = _refitted(fit, points, pixels, found.is_clear, size)
        if _usual_length(found) < NEAR_STEP_PX:
            return fit, False
    return fit, True


def _is_near(found: Alignment) -> bool:
    """Whether what is left to mend is of no account, but for a few corners."""
    moves = np.linalg.norm(found.step[found.is_clear], axis=1)
    return bool(
        len(moves) > 0
        and median(moves) < SMALL_STEP_PX
        and np.count_nonzero(moves > SETTLED_STEP_PX) <= MOST_LATE
        and np.all(np.abs(found.change) < SMALL_CHANGE)
    )


def _usual_length(found: Alignment) -> float:
    """The length of most clear corners' steps, pixels; infinite where none is clear."""
    if not found.is_clear.any():
        return np.inf
    return median(np.linalg.norm(found.step[found.is_clear], axis=1))


def _softened(grey: np.ndarray, pixels: Array) -> np.ndarray:
    """The picture with the part about `pixels` (n, 2) blurred by SOFTENING, the rest left out."""
    low = np.clip(np.floor(pixels.min(axis=0)).astype(int) - _AROUND_PX, 0, None)
    high = np.ceil(pixels.max(axis=0)).astype(int) + _AROUND_PX
    part = np.s_[low[1] : high[1], low[0] : high[0]]
    soft = np.zeros_like(grey)
    if grey[part].size:
        soft[part] = cv2.GaussianBlur(grey[part], (0, 0), SOFTENING**0.5)
    return soft


def _refitted(
    fit: PlanarFit, points: Array, pixels: Array, clear: np.ndarray, size: tuple[int, int]
) -> tuple[PlanarFit, Array]:
    """The plane through the clear corners, and all of them, the others where it has them."""
    usable, better = sound_corners(points[clear], pixels[clear], size, start=fit)
    if better is None:
        return fit, pixels
    kept = clear.copy()
    kept[clear] = usable
    return better, np.where(kept[:, None], pixels, better.project(points))
