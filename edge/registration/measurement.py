"""From about where a face lies to its corners: registered, sorted out, with their sigma."""

from dataclasses import dataclass, replace
from math import sqrt

import cv2
import numpy as np

from trigpoint.edge.image.median import median
from trigpoint.edge.image.time_limit import IsOver, never
from trigpoint.geometry.rotation import Array
from trigpoint.messages import FaceSighting

from .appearance import Appearance
from .blur import Blur
from .patches import CornerPattern
from .planar_fit import PlanarFit
from .plane_fitting import scatter_about
from .registration import Registration, registered
from .sound_corners import sound_corners
from .template_search import found_by_template

LEAST_CORNERS = 4
# What a drawing on half pixels and grey values in whole numbers leave: of rendered faces without
# any noise the best one was off by so much, RMS.
LEAST_SIGMA_PX = 0.003
# Registered corners that lie this far off their plane are not believed: pixels, and share of the
# spacing; more is allowed where all scatter. A corner that looks as printed is where the paper has
# it, which is not flat to better than the second share; one with something before it may be off.
LEAST_WILD_PX = 0.1
LEAST_WILD_SHARE = 0.01
WHOLE_WILD_SHARE = 0.06
# Corners that are so near their plane need no lens of their own, pixels.
ENOUGH_PX = 0.03
# What the picture's noise says of a face's sigma is worth so many squares of what its corners
# scatter about their plane: of rendered faces its variance is up to double or half of the true one,
# as what the drawing leaves counts as noise. It is worth less where scatter exceeds it by more than
# this multiple: no board is quite flat.
NOISE_WORTH = 4.0
MOST_EXCESS = 4.0
_MARGIN_PX = 2.0
# A face that lies so near where it was expected also looks as expected, and is found to a third
# of a pixel; else its size and slant are off too.
SURE_PX = 2.0
# Of the window in which gradients are asked, half, and when they are settled: steps, pixels.
GRADIENTS_HALF_PX = 4
_SETTLING = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 20, 0.01)
# Of a corner of a face that shows too few of them for a plane.
FEW_CORNERS_SIGMA_PX = 0.1


@dataclass(frozen=True, slots=True)
class Measured:
    """Corners of one face. `corners`: (n,) ids, rising; `pixels`: (n, 2); `sigma`: of a coordinate;
    `blur`: of the picture there; `fit`: the plane through them."""

    corners: np.ndarray
    pixels: Array
    sigma: float
    blur: Blur
    fit: PlanarFit


@dataclass(frozen=True, slots=True)
class Located:
    """A face that was found: its look, and where its corners are; `variant`: which of the ways to
    print that look the finder took it for."""

    look: Appearance
    found: Measured
    variant: int = 0

    @property
    def sighting(self) -> FaceSighting:
        """What is sent of it."""
        return self.look.sighting(self.found.corners, self.found.pixels, self.found.sigma)


def measured(
    grey: np.ndarray,
    pattern: CornerPattern,
    fit: PlanarFit,
    *,
    starts: Array | None = None,
    blur: Blur | None = None,
    is_rough: bool = False,
    is_over: IsOver = never,
) -> Measured | None:
    """Every corner that the picture shows of a face that lies about where `fit` has it.

    `starts`: (m, 2) for every corner of the face, where it was found already, not a number where
    not; `blur`, `is_rough` and `is_over`: as of `registered`. None where the picture shows none, or
    those that it shows lie on no plane, or the time is over.
    """
    size = (grey.shape[1], grey.shape[0])
    ids = in_view(fit, pattern.points, size)
    if len(ids) == 0:
        return None
    near = None if starts is None else starts[ids]
    found = registered(
        grey, pattern, fit, ids, starts=near, blur=blur, is_rough=is_rough, is_over=is_over
    )
    if found is None:
        return None
    found = found if near is None else _with_gradients(grey, found, near)
    clear = found.is_clear
    ids, pixels, sigma = ids[clear], found.pixels[clear], found.sigma[clear]
    if 0 < len(ids) < LEAST_CORNERS:
        return Measured(ids, pixels, FEW_CORNERS_SIGMA_PX, found.blur, found.fit)
    keep, plane = sound_corners(
        pattern.points[ids],
        pixels,
        size,
        least_px=LEAST_WILD_PX,
        least_share=np.where(found.is_whole[clear], WHOLE_WILD_SHARE, LEAST_WILD_SHARE),
        enough_px=ENOUGH_PX,
        start=found.fit,
    )
    if plane is None:
        return None
    scatter = scatter_about(plane, pattern.points[ids[keep]], pixels[keep])
    return Measured(ids[keep], pixels[keep], sigma_of(sigma[keep], *scatter), found.blur, plane)


def _with_gradients(grey: np.ndarray, found: Registration, near: Array) -> Registration:
    """With the corners that the search saw, at `near` (n, 2), and that do not look as printed:
    where light clips or a reflection ends. They are where the gradients about them meet, if that is
    near where they were seen; they count as having something before them. Where most are lost, the
    face itself is not as printed."""
    lost = np.flatnonzero(~found.is_clear & ~np.isnan(near[:, 0]))
    if len(lost) == 0 or 2 * len(lost) > len(near):
        return found
    half, starts = 2 * (GRADIENTS_HALF_PX,), near[lost]
    settled = cv2.cornerSubPix(
        grey, starts.reshape(-1, 1, 2).astype(np.float32), half, (-1, -1), _SETTLING
    )
    settled = np.asarray(settled, dtype=float).reshape(-1, 2)
    kept = np.linalg.norm(settled - starts, axis=1) < SURE_PX
    pixels, clear, whole = found.pixels.copy(), found.is_clear.copy(), found.is_whole.copy()
    sigma = found.sigma.copy()
    pixels[lost], clear[lost], whole[lost] = settled, kept, False
    sigma[lost] = FEW_CORNERS_SIGMA_PX
    return replace(found, pixels=pixels, is_clear=clear, is_whole=whole, sigma=sigma)


def placed_again(
    grey: np.ndarray, pattern: CornerPattern, fit: PlanarFit, *, reach_px: float
) -> tuple[PlanarFit, bool] | None:
    """Where a face lies that should lie where `fit` has it, or up to `reach_px` beside that, and
    whether that is rough, as of `measured`; None where it is not to be seen."""
    if reach_px <= 0.0:
        return fit, False
    there = found_by_template(grey, pattern, fit, reach_px)
    if there is None:
        return None
    outline = pattern.face.outline[:, :2]
    aside = np.linalg.norm(there.project(outline) - fit.project(outline), axis=1)
    return there, median(aside) > SURE_PX


def in_view(fit: PlanarFit, points: Array, size: tuple[int, int]) -> np.ndarray:
    """Which points (n, 2) of a face lie in the picture, indices (k,)."""
    pixels = fit.project(points)
    limit = np.array(size) - 1 - _MARGIN_PX
    return np.flatnonzero(np.all((pixels > _MARGIN_PX) & (pixels < limit), axis=-1))


def sigma_of(noise: Array, squares: float, freedom: int) -> float:
    """Standard deviation of a coordinate: what is expected by the picture's noise, for each corner
    (n,), and what is seen, as of `scatter_about`.

    The posterior of a variance under a scaled inverse chi-squared prior (Gelman et al., Bayesian
    Data Analysis, 2.6), which counts for less where the corners deny it.
    """
    expected, seen = float(np.mean(noise**2)), squares / max(freedom, 1)
    excess = MOST_EXCESS * expected
    worth = NOISE_WORTH if seen <= excess else NOISE_WORTH * excess / seen
    return max(LEAST_SIGMA_PX, sqrt((worth * expected + squares) / (worth + freedom)))
