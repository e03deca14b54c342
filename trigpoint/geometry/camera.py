"""Camera models by the names of ROS: plumb_bob, rational_polynomial and equidistant.

Pixels have (0, 0) at the centre of the top-left pixel. Formulae: OpenCV's documentation of
`calib3d` and of `fisheye`.
"""

from dataclasses import dataclass
from enum import StrEnum
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

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


@dataclass(frozen=True, slots=True)
class CameraModel:
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
        if not np.all(np.isfinite([self.fx, self.fy, self.cx, self.cy, *self.distortion])):
            raise ValueError("a camera's intrinsics must be finite numbers")
        missing = len(self.model.coefficients) - len(self.distortion)
        if missing < 0:
            raise ValueError(f"{self.model.value} has {len(self.model.coefficients)} coefficients")
        padded = (*(float(value) for value in self.distortion), *([0.0] * missing))
        object.__setattr__(self, "distortion", padded)

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
        reach = np.linalg.norm(self._distort(np.array([radius, 0.0]))[0])
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
        p = np.asarray(points, dtype=float)
        normalised = p[..., :2] / p[..., 2:]
        if self.model is LensModel.EQUIDISTANT:
            distorted = _distort_equidistant(normalised, self.distortion)[0]
        else:
            distorted = _bent_polynomial(normalised, self.distortion)
        return distorted * [self.fx, self.fy] + [self.cx, self.cy]

    def project_by_point(self, points: ArrayLike) -> tuple[Array, Array]:
        """Pixels (…, 2) and their derivatives by the point (…, 2, 3)."""
        p = np.asarray(points, dtype=float)
        inverse_depth = 1 / p[..., 2]
        normalised = p[..., :2] * inverse_depth[..., None]
        distorted, jacobian = self._distort(normalised)
        focal = np.array([self.fx, self.fy])
        by_point = np.empty((*p.shape[:-1], 2, 3))
        by_point[..., :2] = jacobian * (focal[:, None] * inverse_depth[..., None, None])
        along_x = by_point[..., 0] * normalised[..., :1]
        by_point[..., 2] = -along_x - by_point[..., 1] * normalised[..., 1:]
        return distorted * focal + [self.cx, self.cy], by_point

    def project_jacobians(self, points: ArrayLike) -> tuple[Array, Array, Array]:
        """Pixels (…, 2), their derivatives by the point (…, 2, 3) and by `parameters` (…, 2, p)."""
        p = np.asarray(points, dtype=float)
        pixels, by_point = self.project_by_point(p)
        focal = np.array([self.fx, self.fy])
        by_parameters = np.zeros((*p.shape[:-1], 2, 4 + len(self.distortion)))
        distorted = (pixels - [self.cx, self.cy]) / focal
        by_parameters[..., 0, 0] = distorted[..., 0]
        by_parameters[..., 1, 1] = distorted[..., 1]
        by_parameters[..., 0, 2] = by_parameters[..., 1, 3] = 1
        by_distortion = self._by_distortion(p[..., :2] / p[..., 2:])
        by_parameters[..., :, 4:] = focal[:, None] * by_distortion
        return pixels, by_point, by_parameters

    def sees(self, points: ArrayLike) -> np.ndarray:
        """Which points (…, 3) in the optical frame fall into the picture; (…) bool.

        A direction beyond the angle at which the lens model folds back is not seen.
        """
        p = np.asarray(points, dtype=float)
        ahead = p[..., 2] > 1e-6
        safe = np.where(ahead[..., None], p, [0.0, 0.0, 1.0])
        u, v = np.moveaxis(self.project(safe), -1, 0)
        inside = (u >= -0.5) & (u <= self.width - 0.5) & (v >= -0.5) & (v <= self.height - 0.5)
        unfolded = np.linalg.norm(safe[..., :2] / safe[..., 2:], axis=-1) < _fold_radius(self)
        return ahead & inside & unfolded & (self._determinant(safe) > 0)

    def directions(self, pixels: ArrayLike) -> Array:
        """Normalised coordinates (…, 2) = (x/z, y/z) that project to pixels (…, 2).

        Newton's method from the undistorted guess; NaN where it does not converge to 1e-9.
        """
        target = (np.asarray(pixels, dtype=float) - [self.cx, self.cy]) / [
            self.fx,
            self.fy,
        ]
        if self.model is LensModel.EQUIDISTANT:
            return self._directions_equidistant(target)
        guess = target.copy()
        for _ in range(20):
            distorted, jacobian = self._distort(guess)
            error = target - distorted
            if np.nanmax(np.abs(error), initial=0.0) < 1e-12:
                break
            guess = guess + np.linalg.solve(jacobian, error[..., None])[..., 0]
        error = np.linalg.norm(self._distort(guess)[0] - target, axis=-1, keepdims=True)
        return np.where(error < 1e-9, guess, np.nan)

    def _distort(self, normalised: Array) -> tuple[Array, Array]:
        """Distorted coordinates (…, 2) and their derivative by the undistorted ones (…, 2, 2)."""
        if self.model is LensModel.EQUIDISTANT:
            return _distort_equidistant(normalised, self.distortion)
        return _distort_polynomial(normalised, self.distortion)

    def _by_distortion(self, normalised: Array) -> Array:
        """The derivative of distorted coordinates by `distortion`, (…, 2, coefficients)."""
        if self.model is LensModel.EQUIDISTANT:
            return _by_equidistant(normalised)
        return _by_polynomial(normalised, self.distortion)

    def _determinant(self, points: Array) -> Array:
        by_point = self._distort(points[..., :2] / points[..., 2:])[1]
        return by_point[..., 0, 0] * by_point[..., 1, 1] - by_point[..., 0, 1] * by_point[..., 1, 0]

    def _directions_equidistant(self, target: Array) -> Array:
        radius = np.linalg.norm(target, axis=-1)
        k1, k2, k3, k4 = self.distortion
        angle = radius.copy()
        for _ in range(20):
            s = angle * angle
            value = angle * (1 + s * (k1 + s * (k2 + s * (k3 + s * k4))))
            slope = 1 + s * (3 * k1 + s * (5 * k2 + s * (7 * k3 + s * 9 * k4)))
            step = (value - radius) / slope
            angle = angle - step
            if np.abs(step).max(initial=0.0) < 1e-15:
                break
        scale = np.where(radius > 1e-12, np.tan(angle) / np.where(radius > 0, radius, 1), 1.0)
        return np.where((angle < np.pi / 2)[..., None], target * scale[..., None], np.nan)


@cache
def _fold_radius(camera: CameraModel) -> float:
    """How far from the axis, as x/z, the lens first folds back; inf where it does not.

    Farther out the polynomial may rise again and bring pixels back into the picture.
    """
    radii = np.linspace(0.0, 20.0, 4001)
    line = np.stack([radii, np.zeros_like(radii)], axis=-1)
    folded = np.flatnonzero(np.linalg.det(camera._distort(line)[1]) <= 0)
    return float(radii[folded[0]]) if len(folded) else np.inf


def _bent_polynomial(n: Array, coefficients: tuple[float, ...]) -> Array:
    """`_distort_polynomial` without its derivatives."""
    k1, k2, p1, p2, k3, k4, k5, k6 = (*coefficients, 0.0, 0.0, 0.0)[:8]
    x, y = n[..., 0], n[..., 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    if len(coefficients) > 5:
        radial = radial / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    twice = 2 * (p1 * y + p2 * x)
    bent = np.empty(n.shape)
    bent[..., 0] = x * (radial + twice) + p2 * r2
    bent[..., 1] = y * (radial + twice) + p1 * r2
    return bent


def _distort_polynomial(n: Array, coefficients: tuple[float, ...]) -> tuple[Array, Array]:
    k1, k2, p1, p2, k3, k4, k5, k6 = (*coefficients, 0.0, 0.0, 0.0)[:8]
    x, y = n[..., 0], n[..., 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = k1 + r2 * (2 * k2 + r2 * (3 * k3))  # of radial by r²
    if len(coefficients) > 5:
        below = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
        radial = radial / below
        slope = (slope - radial * (k4 + r2 * (2 * k5 + r2 * (3 * k6)))) / below
    x_tangential, y_tangential = 2 * p1 * x + 2 * p2 * y, 2 * p1 * y + 2 * p2 * x
    distorted = np.empty(n.shape)
    distorted[..., 0] = x * (radial + y_tangential) + p2 * r2
    distorted[..., 1] = y * (radial + y_tangential) + p1 * r2
    jacobian = np.empty((*x.shape, 2, 2))
    jacobian[..., 0, 0] = radial + 2 * slope * x * x + 2 * p1 * y + 6 * p2 * x
    jacobian[..., 0, 1] = jacobian[..., 1, 0] = 2 * slope * x * y + x_tangential
    jacobian[..., 1, 1] = radial + 2 * slope * y * y + 6 * p1 * y + 2 * p2 * x
    return distorted, jacobian


def _by_polynomial(n: Array, coefficients: tuple[float, ...]) -> Array:
    k1, k2, _, _, k3, k4, k5, k6 = (*coefficients, 0.0, 0.0, 0.0)[:8]
    x, y = n[..., 0], n[..., 1]
    r2 = x * x + y * y
    r4, r6 = r2 * r2, r2 * r2 * r2
    above, below = 1 + k1 * r2 + k2 * r4 + k3 * r6, 1 + k4 * r2 + k5 * r4 + k6 * r6
    radial = above / below
    radial_terms = [r2 / below, r4 / below, None, None, r6 / below]
    radial_terms += [-radial * r2 / below, -radial * r4 / below, -radial * r6 / below]
    by_coefficients = np.empty((*x.shape, 2, len(coefficients)))
    for column, term in enumerate(radial_terms[: len(coefficients)]):
        if term is not None:
            by_coefficients[..., 0, column] = x * term
            by_coefficients[..., 1, column] = y * term
    by_coefficients[..., 0, 2] = by_coefficients[..., 1, 3] = 2 * x * y
    by_coefficients[..., 1, 2] = r2 + 2 * y * y
    by_coefficients[..., 0, 3] = r2 + 2 * x * x
    return by_coefficients


def _distort_equidistant(n: Array, coefficients: tuple[float, ...]) -> tuple[Array, Array]:
    k1, k2, k3, k4 = coefficients
    radius = np.linalg.norm(n, axis=-1)
    safe = np.where(radius > 1e-9, radius, 1.0)
    angle = np.arctan(radius)
    s = angle * angle
    bent = angle * (1 + s * (k1 + s * (k2 + s * (k3 + s * k4))))
    slope = 1 + s * (3 * k1 + s * (5 * k2 + s * (7 * k3 + s * 9 * k4)))
    scale = np.where(radius > 1e-9, bent / safe, 1.0)
    by_radius = np.where(radius > 1e-9, (slope / (1 + radius**2) - scale) / safe, 0.0)
    unit = n / safe[..., None]
    jacobian = scale[..., None, None] * np.eye(2) + (
        (by_radius * radius)[..., None, None] * unit[..., :, None] * unit[..., None, :]
    )
    return n * scale[..., None], jacobian


def _by_equidistant(n: Array) -> Array:
    radius = np.linalg.norm(n, axis=-1)
    angle = np.arctan(radius)
    powers = np.stack([angle**3, angle**5, angle**7, angle**9], axis=-1)
    unit = n / np.where(radius > 1e-9, radius, 1.0)[..., None]
    return unit[..., :, None] * powers[..., None, :]
