"""How far corners are off: Gauss-Newton between patches of a picture and the drawing of them.

Lucas and Kanade (1981); brightness and contrast are solved for each corner, the blur for the whole
face (its Gaussian's covariance, by the heat equation: what a wider blur changes is half the second
derivatives). What does not look like the pattern is left out pixel by pixel, or corner by corner.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from trigpoint.geometry.rotation import Array

from .middle import median
from .patches import LEAST_HALF_PX, MARGIN_PX, STEP, Patches

# Bounds of the blur's variances, pixel²: below 0 the camera sharpens, as most webcams do; the upper
# one is that of 6 pixels of motion.
LEAST_BLUR = -1.5
MOST_BLUR = 3.0
# As far as the drawing is blurred at least; what is less is made up by second derivatives.
LEAST_GAUSSIAN = 0.2
# A pixel this far off the drawing, of the face's contrast, shows something else.
FOREIGN_SHARE = 0.25
# Of a corner's pixels, how many must show the pattern, and how many there must be;
LEAST_SHOWN = 0.8
LEAST_PIXELS = (2 * LEAST_HALF_PX + 1) ** 2 / 4
# its contrast, grey levels, and against the face's;
LEAST_CONTRAST = 8.0
LEAST_CONTRAST_SHARE = 0.5
# and how much worse than the face's it may match, beyond a little noise, grey levels².
MOST_MISMATCH = 3.0
QUIET_POWER = 4.0
# What is left may have this share of the drawing's variance, and this noise, grey levels².
MOST_UNEXPLAINED = 0.3
NOISE_POWER = 40.0
# Of the drawing's grey values.
_WHITE = 255.0


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """`step`: (n, 2) from where the pattern was drawn to where it is, pixels; `is_clear`: (n,)
    whether the picture shows it; `sigma`: (n,) of a step's coordinate, by what is left; `blur`:
    (3,) the better one."""

    step: Array
    is_clear: np.ndarray
    sigma: Array
    blur: Array


def aligned(patches: Patches, blur: Array, longest_px: float) -> Alignment:
    """One step for every corner; none is trusted beyond `longest_px`."""
    drawing = _Drawing.of(patches.drawn, blur)
    match = _matched(drawing, patches.seen, patches.weight)
    usual = _Usual.of(match)
    odd = usual.odd(match)
    if odd.any():
        foreign = usual.foreign(drawing, patches.seen)
        weight = np.where(odd[:, None] & foreign, np.float32(0), patches.weight)
        match = _matched(drawing, patches.seen, weight)
        usual = _Usual.of(match)
    clear = _clear(drawing, match, usual, patches)
    change = _blur_change(drawing, match, clear)
    adapted = match.values - match.gain[:, None] * (match.by_blur @ change)
    step = -adapted[:, :2] / np.maximum(adapted[:, 2:3], 1e-6)
    length = np.linalg.norm(step, axis=1)
    step *= np.minimum(1.0, longest_px / np.maximum(length, 1e-9))[:, None]
    clear &= length < 2 * longest_px
    inverse = np.linalg.inv(match.normal)
    spread = np.maximum(0.5 * (inverse[:, 0, 0] + inverse[:, 1, 1]), 0.0)
    sigma = np.sqrt(match.power * spread) / np.maximum(match.gain, 1e-6)
    return Alignment(step, clear, sigma, _bounded(blur + change))


@dataclass(frozen=True, slots=True, eq=False)
class _Drawing:
    """What the picture is held against, float32. `columns`: (n, m, 4) x and y derivative, value and
    1; `bend`: (n, m, 3) what each number of the blur changes."""

    columns: np.ndarray
    bend: np.ndarray

    @classmethod
    def of(cls, drawn: np.ndarray, blur: Array) -> "_Drawing":
        n = len(drawn)
        soft = _blurred(drawn, blur)
        value, by_x, by_y, *second = (part.reshape(n, -1) for part in _derivatives(soft))
        columns = np.stack([by_x, by_y, value, np.ones_like(value)], axis=-1)
        return cls(columns, np.stack(second, axis=-1))

    @property
    def value(self) -> np.ndarray:
        """The drawing itself, (n, m)."""
        return self.columns[..., 2]


@dataclass(frozen=True, slots=True, eq=False)
class _Match:
    """The best match of each corner. `weight`, `residual`: (n, m); `normal`: (n, 4, 4); `values`:
    (n, 4) coefficients of the columns; `by_blur`: (n, 4, 3) those that take up a change of blur;
    `power`: (n,) mean square of what is left."""

    weight: np.ndarray
    residual: np.ndarray
    normal: Array
    values: Array
    by_blur: Array
    power: Array

    @property
    def gain(self) -> Array:
        """Contrast of each corner, of the drawing's."""
        return self.values[:, 2]


@dataclass(frozen=True, slots=True)
class _Usual:
    """What most corners of the face have: contrast, brightness and mean square of what is left."""

    gain: float
    level: float
    power: float

    @classmethod
    def of(cls, match: _Match) -> "_Usual":
        return cls(median(match.gain), median(match.values[:, 3]), median(match.power))

    @property
    def most_power(self) -> float:
        """What may be left of a corner."""
        return MOST_MISMATCH**2 * (self.power + QUIET_POWER)

    def odd(self, match: _Match) -> np.ndarray:
        """Which corners (n,) something else may cover in part."""
        return (match.power > self.most_power) | (match.gain < LEAST_CONTRAST_SHARE * self.gain)

    def foreign(self, drawing: _Drawing, seen: np.ndarray) -> np.ndarray:
        """Which pixels (n, m) show something else."""
        limit = FOREIGN_SHARE * _WHITE * abs(self.gain)
        return np.abs(seen - self.gain * drawing.value - self.level) > limit


def _matched(drawing: _Drawing, seen: np.ndarray, weight: np.ndarray) -> _Match:
    """Weighted least squares of what is seen, and of the changes of blur, by the columns."""
    weighted = np.swapaxes(drawing.columns * weight[..., None], 1, 2)
    scale = np.array([1.0, 1.0, 1.0, _WHITE])
    normal = (weighted @ drawing.columns).astype(float) * np.outer(scale, scale)
    normal += 1e-3 * np.eye(4)
    right = (weighted @ np.concatenate([seen[..., None], drawing.bend], axis=-1)).astype(float)
    solved = np.linalg.solve(normal, scale[:, None] * right) * scale[:, None]
    values = solved[:, :, 0]
    residual = seen - (drawing.columns @ values.astype(np.float32)[..., None])[..., 0]
    power = np.sum(weight * residual * residual, axis=1) / np.maximum(weight.sum(axis=1), 1.0)
    return _Match(weight, residual, normal, values, solved[:, :, 1:], power.astype(float))


def _clear(drawing: _Drawing, match: _Match, usual: _Usual, patches: Patches) -> np.ndarray:
    """Which corners (n,) the picture shows as they are printed."""
    shown, total = match.weight.sum(axis=1), patches.weight.sum(axis=1)
    least_gain = max(LEAST_CONTRAST_SHARE * usual.gain, LEAST_CONTRAST / _WHITE)
    variance = match.gain**2 * _variance(drawing.value, match.weight)
    return (
        (shown > np.maximum(LEAST_SHOWN * total, LEAST_PIXELS))
        & (match.gain > least_gain)
        & (match.power < usual.most_power)
        & (match.power < NOISE_POWER + MOST_UNEXPLAINED * variance)
    )


def _variance(values: np.ndarray, weight: np.ndarray) -> Array:
    """Weighted variance (n,) of values (n, m)."""
    total = np.maximum(weight.sum(axis=1), 1.0)
    mean = np.sum(weight * values, axis=1) / total
    centred = values - mean[:, None]
    return (np.sum(weight * centred * centred, axis=1) / total).astype(float)


def _blur_change(drawing: _Drawing, match: _Match, clear: np.ndarray) -> Array:
    """The change of blur (3,) that all clear corners together ask for."""
    if not clear.any():
        return np.zeros(3)
    gain = np.where(clear, match.gain, 0.0).astype(np.float32)
    free = drawing.bend - drawing.columns @ match.by_blur.astype(np.float32)
    flat = (free * gain[:, None, None]).reshape(-1, 3)
    weighted = flat * match.weight.reshape(-1, 1)
    normal = (flat.T @ weighted).astype(float)
    right = (weighted.T @ match.residual.reshape(-1)).astype(float)
    normal += (1e-3 * np.trace(normal) + 1e-9) * np.eye(3)
    return np.clip(np.linalg.solve(normal, right), -1.0, 1.0)


def _blurred(drawn: np.ndarray, blur: Array) -> np.ndarray:
    """Patches (n, l, l) blurred by variances and covariance `blur`, pixel²."""
    n, side, _ = drawn.shape
    soft = cv2.filter2D(drawn.reshape(n * side, side), cv2.CV_32F, _kernel(blur))
    return soft.reshape(n, side, side)


def _kernel(blur: Array) -> np.ndarray:
    """What blurs so on the lattice, (2r + 1, 2r + 1) float32: a Gaussian along each principal axis,
    of LEAST_GAUSSIAN at least; less than that by its second derivative (the heat equation)."""
    variances, axes = np.linalg.eigh(STEP**2 * np.array([[blur[0], blur[2]], [blur[2], blur[1]]]))
    spread = np.maximum(variances, STEP**2 * LEAST_GAUSSIAN)
    radius = int(np.clip(np.ceil(2.6 * np.sqrt(spread.max())), 2, 6))
    places = np.arange(-radius, radius + 1)
    along = np.stack(np.meshgrid(places, places), axis=-1) @ axes / np.sqrt(spread)
    short = (variances - spread) / spread
    kernel = np.exp(-0.5 * (along**2).sum(axis=-1)) * (1 + 0.5 * (along**2 - 1) @ short)
    return (kernel / kernel.sum()).astype(np.float32)


def _derivatives(soft: np.ndarray) -> tuple[np.ndarray, ...]:
    """Value, x and y derivative at whole pixels, and what variance xx, variance yy and covariance
    of a blur change; (n, k, k) each."""

    def at(dx: int, dy: int) -> np.ndarray:
        low, high = STEP * MARGIN_PX, soft.shape[1] - STEP * MARGIN_PX
        return soft[:, low + dy : high + dy : STEP, low + dx : high + dx : STEP]

    value, right, left, below, above = at(0, 0), at(1, 0), at(-1, 0), at(0, 1), at(0, -1)
    by_xx, by_yy = 2 * (right + left - 2 * value), 2 * (below + above - 2 * value)
    by_xy = at(1, 1) - at(-1, 1) - at(1, -1) + at(-1, -1)
    return value, right - left, below - above, by_xx, by_yy, by_xy


def _bounded(blur: Array) -> Array:
    """The blur with both of its principal variances between the bounds."""
    values, axes = np.linalg.eigh(np.array([[blur[0], blur[2]], [blur[2], blur[1]]]))
    matrix = (axes * np.clip(values, LEAST_BLUR, MOST_BLUR)) @ axes.T
    return np.array([matrix[0, 0], matrix[1, 1], matrix[0, 1]])
