"""From about where a face lies to its corners: registered, sorted out, with their sigma."""

from dataclasses import dataclass

import numpy as np

from trigpoint.geometry.rotation import Array
from trigpoint.messages import FaceSighting

from .blur import Blur
from .detector import Appearance, IsOver, never
from .glimpse import glimpsed
from .middle import median
from .patches import CornerPattern
from .planar_fit import PlanarFit, sound_corners
from .registration import registered

LEAST_CORNERS = 4
# The noise of sharp pictures allows less, but no lens model and no print is true to that: a camera
# before which the demo's robot stood came out 3.5 of its sigmas (0.03 mm) off with 0.003 here.
LEAST_SIGMA_PX = 0.02
# Registered corners that lie this far off their plane are not believed: pixels, and share of the
# spacing; more is allowed where all scatter, since real boards are not flat.
LEAST_WILD_PX = 0.1
LEAST_WILD_SHARE = 0.01
# Corners that are so near their plane need no lens of their own, pixels.
ENOUGH_PX = 0.03
# Parameters of a planar fit: a homography, and a lens that few corners hardly show.
_PLANE_FREEDOM = 9
# Scatter about a plane counts beyond this multiple of the noise's variance, and beyond what the
# fit's lens, which is round about the picture's middle, cannot follow.
_EXPLAINED = 4.0
LENS_PX = 0.015
_MARGIN_PX = 2.0
# A face that lies so near where it was expected also looks as expected, and is glimpsed to a third
# of a pixel; else its size and slant are off too.
SURE_PX = 2.0
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
    """A face that was found: its look, and where its corners are."""

    look: Appearance
    found: Measured

    @property
    def sighting(self) -> FaceSighting:
        """What is sent of it."""
        return self.look.sighting(self.found.corners, self.found.pixels, self.found.sigma)


def measured(
    grey: np.ndarray,
    pattern: CornerPattern,
    fit: PlanarFit,
    *,
    blur: Blur | None = None,
    is_rough: bool = False,
    is_over: IsOver = never,
) -> Measured | None:
    """Every corner that the picture shows of a face that lies about where `fit` has it.

    `blur`, `is_rough` and `is_over`: as of `registered`. None where the picture shows none, or
    those that it shows lie on no plane, or the time is over.
    """
    size = (grey.shape[1], grey.shape[0])
    ids = in_view(fit, pattern.points, size)
    if len(ids) == 0:
        return None
    found = registered(grey, pattern, fit, ids, blur=blur, is_rough=is_rough, is_over=is_over)
    if found is None:
        return None
    clear = found.is_clear
    ids, pixels, sigma = ids[clear], found.pixels[clear], found.sigma[clear]
    if 0 < len(ids) < LEAST_CORNERS:
        return Measured(ids, pixels, FEW_CORNERS_SIGMA_PX, found.blur, found.fit)
    keep, plane = sound_corners(
        pattern.points[ids],
        pixels,
        size,
        least_px=LEAST_WILD_PX,
        least_share=LEAST_WILD_SHARE,
        enough_px=ENOUGH_PX,
        start=found.fit,
    )
    if plane is None:
        return None
    distances = plane.residuals(pattern.points[ids[keep]], pixels[keep])
    return Measured(ids[keep], pixels[keep], sigma_of(distances, sigma[keep]), found.blur, plane)


def placed_again(
    grey: np.ndarray, pattern: CornerPattern, fit: PlanarFit, *, reach_px: float
) -> tuple[PlanarFit, bool] | None:
    """Where a face lies that should lie where `fit` has it, or up to `reach_px` beside that, and
    whether that is rough, as of `measured`; None where it is not to be seen."""
    if reach_px <= 0.0:
        return fit, False
    there = glimpsed(grey, pattern, fit, reach_px)
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


def sigma_of(distances: Array, noise: Array) -> float:
    """Standard deviation of a coordinate, from what the picture's noise makes of each corner (n,),
    and from their distances (n,) to a plane, as far as noise and the fit's lens explain them not:
    boards are not flat."""
    freedom = max(1, 2 * len(distances) - _PLANE_FREEDOM)
    usual = median(noise) ** 2
    scatter = float(np.sum(distances**2)) / freedom
    unexplained = max(0.0, scatter - _EXPLAINED * usual - LENS_PX**2)
    return max(LEAST_SIGMA_PX, float(np.sqrt(usual + unexplained)))
