"""From about where a face lies to its corners, with their sigma: measured by the core
(`native/src/registration`)."""

import numpy as np
from msgspec import Struct

from trigpoint.contract.messages import FaceSighting
from trigpoint.edge.image.median import median
from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In, Kernel, Out

from .appearance import Appearance
from .blur import SHARP, Blur
from .corner_pattern import CornerPattern, Print
from .planar_fit import FIT, PlanarFit
from .template_search import found_by_template

LEAST_CORNERS = 4
# A face that lies so near where it was expected also looks as expected, and is found to a third
# of a pixel; else its size and slant are off too.
SURE_PX = 2.0
_MEASURED = Kernel(
    "tp_measured",
    In(np.uint8, ("h", "w")),
    Print,
    In(np.float64, (FIT,)),
    In(np.float64, ("m", 2)),
    In(np.float64, (4,)),
    int,
    In(np.int64, ("k",)),
    float,
    Out(np.int64, ("n",)),
    Out(np.float64, ("n", 2)),
    Out(np.float64, (5,)),
    Out(np.float64, (FIT,)),
)
_NO_STARTS, _NO_CORNERS = np.empty((0, 2)), np.empty(0, np.int64)
_IN_VIEW = Kernel("tp_in_view", In(np.float64, (FIT,)), In(np.float64, ("n", 2)), int, int)


class Measured(Struct, frozen=True):
    """Corners of one face. `corners`: (n,) ids, rising; `pixels`: (n, 2); `sigma`: of a coordinate;
    `blur`: of the picture there; `fit`: the plane through them."""

    corners: np.ndarray
    pixels: Array
    sigma: float
    blur: Blur
    fit: PlanarFit

    @property
    def middle(self) -> Array:
        """The mean of the pixels, (2,)."""
        return np.add.reduce(self.pixels) / len(self.pixels)

    @property
    def extent(self) -> Array:
        """The pixels' width and height, (2,)."""
        return np.maximum.reduce(self.pixels) - np.minimum.reduce(self.pixels)

    def is_near(self, other: "Measured") -> bool:
        """Whether both are in one place, as two sightings of one face are."""
        return bool(np.all(np.abs(self.middle - other.middle) < 0.25 * other.extent))


class Located(Struct, frozen=True):
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
    starts: Array = _NO_STARTS,
    blur: Blur = SHARP,
    is_rough: bool = False,
    last: np.ndarray = _NO_CORNERS,
    least_again: float = 0.0,
) -> Measured | None:
    """Every corner that the picture shows of a face that lies about where `fit` has it: to a pixel
    or so, or to two or three where `is_rough`.

    `starts`: (m, 2) for every corner of the face, where it was found already, not a number where
    not; `blur`: of the picture there, as it was last. None where the picture shows none, or those
    that it shows lie on no plane, or are less than `least_again` of those of `last` (k,), corners,
    that are in view.
    """
    count = len(pattern.points)
    ids, pixels = np.empty(count, np.int64), np.empty((count, 2))
    numbers, found = np.empty(5), np.empty(FIT)
    seen = _MEASURED(
        np.ascontiguousarray(grey),
        pattern.core,
        fit.packed,
        starts,
        np.array([*blur.variances, blur.response]),
        is_rough,
        last,
        least_again,
        ids,
        pixels,
        numbers,
        found,
    )
    if seen == 0:
        return None
    return Measured(
        ids[:seen],
        pixels[:seen],
        float(numbers[0]),
        Blur(numbers[1:4].copy(), float(numbers[4])),
        PlanarFit(found),
    )


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
    aside = there.residuals(pattern.outline, fit.project(pattern.outline))
    return there, median(aside) > SURE_PX


def in_view(fit: PlanarFit, points: Array, size: tuple[int, int]) -> int:
    """How many points (n, 2) of a face lie in the picture."""
    return _IN_VIEW(fit.packed, points, *size)
