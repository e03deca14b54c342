"""Camera models by the names of ROS: plumb_bob, rational_polynomial and equidistant.

Pixels have (0, 0) at the centre of the top-left pixel. Formulae: OpenCV's documentation of
`calib3d` and of `fisheye`.
"""

import math
from enum import StrEnum
from functools import cache

import numpy as np
from msgspec import Struct
from msgspec.structs import force_setattr
from numpy.typing import ArrayLike

from trigpoint.native.library import In, Kernel, Out

from .rotation import Array

_OTHER_NAMES = (
    ("plumb_bob", "plumbbob radtan radialtangential brownconrady opencv none"),
    ("rational_polynomial", "rationalpolynomial rational fullopencv"),
    ("equidistant", "equi fisheye kannalabrandt kannalabrandt4 kannalabrandt8 opencvfisheye kb4"),
)
# A fisheye whose circle is all around, 360°, just in the picture has 1 / 2π of the side.
_LEAST_FOCAL = 0.05
_OUTSIDE = 0.25
"""A principal point so far outside, of the picture's side: a shifted lens has none like it."""
_GRID = 101
_REAL = np.float64
_POINTS = In(_REAL, ("n", 3))
_PROJECTED = Kernel(
    "tp_lens_projected",
    *(In(_REAL, ("p",)), _POINTS, Out(_REAL, ("n", 2)), Out(_REAL, ("d", 6))),
    Out(_REAL, ("e", "columns")),
)
_SEEN = Kernel("tp_lens_sees", In(_REAL, ("p",)), _POINTS, In(_REAL, (4,)), Out(np.bool_, ("n",)))
_DIRECTIONS = Kernel(
    "tp_lens_directions", In(_REAL, ("p",)), In(_REAL, ("n", 2)), Out(_REAL, ("n", 2))
)


class LensModel(StrEnum):
    """Distortion model, with the coefficients' order of ROS and OpenCV."""

    PLUMB_BOB = "plumb_bob"
    RATIONAL_POLYNOMIAL = "rational_polynomial"
    EQUIDISTANT = "equidistant"

    @classmethod
    def _missing_(cls, value: object) -> "LensModel | None":
        """The model by the names that other tools have for it."""
        word = "".join(letter for letter in str(value).lower() if letter.isalnum())
        return next((cls(model) for model, words in _OTHER_NAMES if word in words.split()), None)

    @property
    def coefficients(self) -> tuple[str, ...]:
        """The names of its distortion coefficients, in their order."""
        return {
            "plumb_bob": ("k1", "k2", "p1", "p2", "k3"),
            "rational_polynomial": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
            "equidistant": ("k1", "k2", "k3", "k4"),
        }[self.value]


class CameraModel(Struct, frozen=True):
    """A camera's intrinsics: from a direction to a raw (distorted) pixel.

    `distortion` has as many numbers as the model; fewer are filled up with zeros.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()
    model: LensModel = LensModel.PLUMB_BOB

    def __post_init__(self) -> None:
        if self.width <= 0 or self.height <= 0 or not (self.fx > 0 and self.fy > 0):
            raise ValueError("a camera needs a positive width, height and focal length")
        if not all(map(math.isfinite, (self.fx, self.fy, self.cx, self.cy, *self.distortion))):
            raise ValueError("a camera's intrinsics must be finite numbers")
        missing = len(self.model.coefficients) - len(self.distortion)
        if missing < 0:
            raise ValueError(f"{self.model.value} has {len(self.model.coefficients)} coefficients")
        padded = (*(float(value) for value in self.distortion), *([0.0] * missing))
        force_setattr(self, "distortion", padded)

    @classmethod
    def from_field_of_view(cls, width: int, height: int, horizontal_rad: float) -> "CameraModel":
        """A nominal camera without distortion, its principal point in the middle."""
        focal = width / (2 * np.tan(horizontal_rad / 2))
        return cls(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)

    def check(self) -> None:
        """Raise ValueError where no camera has such a lens."""
        size = f"a picture of {self.width} × {self.height}"
        for side, focal, centre in (
            (self.width, self.fx, self.cx),
            (self.height, self.fy, self.cy),
        ):
            if focal < _LEAST_FOCAL * side:
                raise ValueError(
                    f"a focal length of {focal:g} pixels cannot be with {size}: is it in mm, or of "
                    "another size?"
                )
            if not -_OUTSIDE * side <= centre <= (1 + _OUTSIDE) * side:
                raise ValueError(
                    f"the principal point ({self.cx:g}, {self.cy:g}) lies far outside of {size}: "
                    "is it of another size?"
                )
        if self.folded_share() > 0.5:
            raise ValueError(
                f"the distortion folds back, so that most of {size} shows nothing: are its "
                "coefficients of another model, or in another order?"
            )

    def folded_share(self) -> float:
        """The share of the picture that lies farther out than where the lens model folds back."""
        radius = _fold_radius(self)
        if radius == np.inf:
            return 0.0
        pixel = self.project([radius, 0.0, 1.0])
        reach = np.hypot(*((pixel - [self.cx, self.cy]) / [self.fx, self.fy]))
        x = (np.linspace(0, self.width - 1, _GRID) - self.cx) / self.fx
        y = (np.linspace(0, self.height - 1, _GRID) - self.cy) / self.fy
        return float(np.mean(np.hypot(x, y[:, None]) > reach))

    @property
    def matrix(self) -> Array:
        """K, (3, 3)."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])

    @property
    def parameters(self) -> Array:
        """fx, fy, cx, cy and the distortion coefficients; (4 + coefficients,)."""
        return np.array([self.fx, self.fy, self.cx, self.cy, *self.distortion])

    def with_parameters(self, parameters: ArrayLike) -> "CameraModel":
        """The same camera with other `parameters` (inverse of the property)."""
        fx, fy, cx, cy, *distortion = (
            float(value) for value in np.asarray(parameters, dtype=float)
        )
        return CameraModel(self.width, self.height, fx, fy, cx, cy, tuple(distortion), self.model)

    def project(self, points: ArrayLike) -> Array:
        """Pixels (…, 2) of points (…, 3) in the optical frame; points behind it give nonsense."""
        return self._projected(points)[0]

    def project_by_point(self, points: ArrayLike) -> tuple[Array, Array]:
        """Pixels (…, 2) and their derivatives by the point (…, 2, 3)."""
        return self._projected(points, by_point=True)[:2]

    def project_jacobians(self, points: ArrayLike) -> tuple[Array, Array, Array]:
        """Pixels (…, 2), their derivatives by the point (…, 2, 3) and by `parameters` (…, 2, p)."""
        return self._projected(points, by_point=True, by_parameters=True)

    def _projected(
        self, points: ArrayLike, *, by_point: bool = False, by_parameters: bool = False
    ) -> tuple[Array, Array, Array]:
        """Pixels and their derivatives, empty where these are not asked for."""
        flat, shape = _rows(points, 3)
        parameters = self.parameters
        pixels = np.empty((len(flat), 2))
        by_points = np.empty((len(flat) * by_point, 6))
        by_each = np.empty((len(flat) * by_parameters, 2 * len(parameters)))
        _PROJECTED(parameters, flat, pixels, by_points, by_each)
        return (
            pixels.reshape(*shape, 2),
            by_points.reshape(*(shape if by_point else (0,)), 2, 3),
            by_each.reshape(*(shape if by_parameters else (0,)), 2, len(parameters)),
        )

    def sees(self, points: ArrayLike, *, margin_px: float = -0.5) -> np.ndarray:
        """Which points (…, 3) in the optical frame fall into the picture, so far from the middles
        of its outermost pixels; (…) bool.

        A direction beyond the angle at which the lens model folds back is not seen.
        """
        flat, shape = _rows(points, 3)
        seen = np.empty(len(flat), dtype=bool)
        _SEEN(self.parameters, flat, self.limits(margin_px), seen)
        return seen.reshape(shape)

    def limits(self, margin_px: float) -> Array:
        """Where it sees, as the core takes it (`Frame` of `lens.hpp`), (4,): the picture's size,
        where the lens folds back, and the margin."""
        return np.array([self.width, self.height, _fold_radius(self), margin_px], dtype=float)

    def directions(self, pixels: ArrayLike) -> Array:
        """Normalised coordinates (…, 2) = (x/z, y/z) that project to pixels (…, 2).

        Newton's method from the undistorted guess; NaN where it does not converge to 1e-9.
        """
        flat, shape = _rows(pixels, 2)
        found = np.empty((len(flat), 2))
        _DIRECTIONS(self.parameters, flat, found)
        return found.reshape(*shape, 2)


def _rows(values: ArrayLike, width: int) -> tuple[Array, tuple[int, ...]]:
    """Values (…, width) as rows in one piece, and the shape (…)."""
    array = np.asarray(values, dtype=float)
    return np.ascontiguousarray(array.reshape(-1, width)), array.shape[:-1]


@cache
def _fold_radius(camera: CameraModel) -> float:
    """How far from the axis, as x/z, the lens first folds back; inf where it does not.

    Farther out the polynomial may rise again and bring pixels back into the picture.
    """
    radii = np.linspace(0.0, 20.0, 4001)
    line = np.stack([radii, np.zeros_like(radii), np.ones_like(radii)], axis=-1)
    folded = np.flatnonzero(np.linalg.det(camera.project_by_point(line)[1][..., :2]) <= 0)
    return float(radii[folded[0]]) if len(folded) else np.inf
