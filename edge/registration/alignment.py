"""How far corners are off: Gauss-Newton between patches of a picture and the drawing of them.

Lucas and Kanade (1981); contrast, brightness and how that rises across are solved for each corner
(uneven light would pull at it), the blur for the whole face (`Blur`; its variances by the heat
equation: what a wider blur changes is half the second derivatives). What does not look like the
pattern is left out pixel by pixel, or corner by corner.
"""

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from trigpoint.edge.image.median import median
from trigpoint.geometry.rotation import Array

from .blur import LEAST_SOFT_VARIANCE, LEAST_VARIANCE, Blur
from .patches import LEAST_HALF_PX, MARGIN_PX, STEP, Patches

# A pixel this far off the drawing, of the face's contrast, shows something else.
FOREIGN_SHARE = 0.25
# Of a corner's pixels, how many must show the pattern, and how many there must be;
LEAST_SHOWN = 0.8
LEAST_PIXELS = (2 * LEAST_HALF_PX + 1) ** 2 / 4
# its contrast, grey levels, and against the face's;
LEAST_CONTRAST = 8.0
LEAST_CONTRAST_SHARE = 0.25
# and how much worse than the face's it may match, beyond a little noise, grey levels².
MOST_MISMATCH = 3.0
QUIET_POWER = 4.0
# A seam in the print or a scratch may leave this share of the drawing's variance all the same.
SCRATCHED_SHARE = 0.07
# What is left may have this share of the drawing's variance, and this noise, grey levels².
MOST_UNEXPLAINED = 0.3
NOISE_POWER = 40.0
_WHITE, _MIDDLE = 255.0, 128.0
# What each row of a drawing is: first of the corner, then of the face's blur, then what is seen.
_BY_X, _BY_Y, _VALUE, _ONE, _X, _Y, _XX, _YY, _XY, _BUMP, _SEEN = range(11)
_ROWS, _OWN = 11, 6
_LEAST_OWN = 1e-6 * np.eye(_OWN)


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """`step`: (n, 2) from where the pattern was drawn to where it is, pixels; `is_clear`: (n,)
    whether the picture shows it; `is_whole`: (n,) whether all about it looks as printed; `sigma`:
    (n,) of a step's coordinate, by what is left; `blur`: the better one; `change`: (4,) by how
    much; `usual`: what most corners have."""

    step: Array
    is_clear: np.ndarray
    is_whole: np.ndarray
    sigma: Array
    blur: Blur
    change: Array
    usual: "Usual"


def aligned(
    patches: Patches,
    blur: Blur,
    longest_px: float,
    *,
    usual: "Usual | None" = None,
    is_light_even: bool = False,
    is_balanced: bool = True,
) -> Alignment:
    """One step for every corner; none is trusted beyond `longest_px`. `usual`: what most of the
    face's corners have, where these are only a few of them. `is_light_even`: better from far off,
    where light that rises would take up what the steps should. `is_balanced`: see CornerPattern;
    else neither response nor sharpening can be told from steps, and neither is."""
    rows = _rows(patches, blur)
    if is_light_even:
        rows[:, _X : _Y + 1] = 0
    match = _Match.of(rows)
    most = usual or Usual.of(match)
    odd = most.odd(match)
    if odd.any():
        rows[odd] *= ~most.foreign(rows[odd], match.values[odd])[:, None]
        match = match.replaced(odd, _Match.of(rows[odd]))
        most = usual or Usual.of(match)
    clear = _clear(match, most, patches)
    change = _blur_change(match, clear, with_response=is_balanced)
    adapted = match.values - match.gain[:, None] * (match.by_blur @ change)
    step = -adapted[:, :2] / np.maximum(adapted[:, 2:3], 1e-6 * _WHITE)
    length = np.linalg.norm(step, axis=1)
    step *= np.minimum(1.0, longest_px / np.maximum(length, 1e-9))[:, None]
    spread = np.maximum(0.5 * (match.inverse[:, 0, 0] + match.inverse[:, 1, 1]), 0.0)
    sigma = np.sqrt(match.power * spread) / np.maximum(match.gain, 1e-6 * _WHITE)
    mended = blur.changed(change, least=LEAST_VARIANCE if is_balanced else LEAST_SOFT_VARIANCE)
    return Alignment(step, clear, ~odd, sigma, mended, change, most)


def _rows(patches: Patches, blur: Blur) -> np.ndarray:
    """(n, 11, m) float32, 0 where a pixel does not count: what a corner's place, contrast,
    brightness and the rise of that change, then what each number of the blur changes, for a
    contrast of 1; what is seen, from middle grey."""
    n, m = patches.seen.shape
    side = round(m**0.5)
    soft = _softened(patches.drawn, blur)
    rows = np.empty((n, _ROWS, m), np.float32)
    _differentiated(soft, rows.reshape(n, _ROWS, side, side))
    value = rows[:, _VALUE]
    bump = rows[:, _BUMP]
    np.subtract(1, value, out=bump)
    bump *= value
    if blur.response:
        slope = 1 + np.float32(blur.response) * (1 - 2 * value)
        rows[:, _BY_X : _BY_Y + 1] *= slope[:, None]
        rows[:, _XX : _XY + 1] *= slope[:, None]
        value += np.float32(blur.response) * bump
    np.subtract(patches.seen, np.float32(_MIDDLE), out=rows[:, _SEEN])
    rows[:, [_ONE, _X, _Y]] = _light(side)
    rows *= patches.weight[:, None]
    return rows


@cache
def _light(side: int) -> np.ndarray:
    """Even light, and light that rises along x and along y by 1 altogether; (3, side²) float32."""
    across = np.broadcast_to(np.linspace(-0.5, 0.5, side, dtype=np.float32), (side, side))
    return np.stack([np.ones_like(across), across, across.T]).reshape(3, -1)


def _softened(drawn: np.ndarray, blur: Blur) -> np.ndarray:
    """Patches (n, l, l), blurred, white as 1."""
    n, side, _ = drawn.shape
    kernel = blur.kernel(STEP) / np.float32(_WHITE)
    soft = cv2.filter2D(drawn.reshape(n * side, side), cv2.CV_32F, kernel)
    return soft.reshape(n, side, side)


def _differentiated(soft: np.ndarray, rows: np.ndarray) -> None:
    """Put x and y derivative and value at whole pixels, and what variance xx, variance yy and
    covariance of a blur change, into rows (n, 11, k, k); white is 1."""

    def at(dx: int, dy: int) -> np.ndarray:
        low, high = STEP * MARGIN_PX, soft.shape[1] - STEP * MARGIN_PX
        return soft[:, low + dy : high + dy : STEP, low + dx : high + dx : STEP]

    value, right, left, below, above = at(0, 0), at(1, 0), at(-1, 0), at(0, 1), at(0, -1)
    _sloped(right - left, at(2, 0) - at(-2, 0), rows[:, _BY_X])
    _sloped(below - above, at(0, 2) - at(0, -2), rows[:, _BY_Y])
    rows[:, _VALUE] = value
    twice = 2 * value
    rows[:, _XX] = right + left - twice
    rows[:, _YY] = below + above - twice
    rows[:, _XX : _YY + 1] *= 2
    rows[:, _XY] = at(1, 1) - at(-1, 1) - at(1, -1) + at(-1, -1)


def _sloped(near: np.ndarray, far: np.ndarray, slope: np.ndarray) -> None:
    """Put the derivative a pixel into `slope`, from differences over a pixel and over two: to the
    fourth order, as blurred edges need; over one pixel alone it comes out a twentieth too low, and
    a step as much too long, which takes another round to mend."""
    np.multiply(near, np.float32(4 / 3), out=slope)
    far *= np.float32(1 / 6)
    slope -= far


@dataclass(frozen=True, slots=True, eq=False)
class _Match:
    """The best match of each corner, by linear least squares. `count`: (n,) pixels; `variance`:
    (n,) the drawing's; `inverse`: (n, 6, 6) of the normal equations of a corner's own numbers;
    `values`: (n, 6) of these; `by_blur`: (n, 6, 4) those that take up a change of blur; `left`:
    (n, 5, 5) products of the blur's rows, and of what is seen, after that."""

    count: Array
    variance: Array
    inverse: Array
    values: Array
    by_blur: Array
    left: Array

    @classmethod
    def of(cls, rows: np.ndarray) -> "_Match":
        """The match of rows (n, 11, m)."""
        products = (rows @ rows.swapaxes(1, 2)).astype(float)
        count = products[:, _ONE, _ONE]
        some = np.maximum(count, 1.0)
        variance = products[:, _VALUE, _VALUE] / some - (products[:, _VALUE, _ONE] / some) ** 2
        inverse = np.linalg.inv(products[:, :_OWN, :_OWN] + _LEAST_OWN)
        right = products[:, :_OWN, _OWN:]
        solved = inverse @ right
        left = products[:, _OWN:, _OWN:] - right.swapaxes(1, 2) @ solved
        return cls(count, variance, inverse, solved[:, :, 4], solved[:, :, :4], left)

    def replaced(self, which: np.ndarray, others: "_Match") -> "_Match":
        """These, `which` (n,) of them replaced by others."""
        parts = []
        for name in self.__slots__:
            part = getattr(self, name).copy()
            part[which] = getattr(others, name)
            parts.append(part)
        return _Match(*parts)

    @property
    def gain(self) -> Array:
        """Contrast of each corner, grey levels."""
        return self.values[:, _VALUE]

    @property
    def power(self) -> Array:
        """Mean square of what is left, (n,), grey levels²."""
        return np.maximum(self.left[:, 4, 4], 0.0) / np.maximum(self.count, 1.0)


@dataclass(frozen=True, slots=True)
class Usual:
    """What most corners of the face have: contrast, brightness and mean square of what is left."""

    gain: float
    level: float
    power: float

    @classmethod
    def of(cls, match: _Match) -> "Usual":
        return cls(median(match.gain), median(match.values[:, _ONE]), median(match.power))

    def most_power(self, gain: Array) -> Array:
        """What may be left of corners of some contrast (n,): where more light falls there is more
        of everything."""
        lit = np.maximum(gain / max(self.gain, LEAST_CONTRAST), 1.0)
        return MOST_MISMATCH**2 * (self.power * lit**2 + QUIET_POWER)

    def odd(self, match: _Match) -> np.ndarray:
        """Which corners (n,) something else may cover in part."""
        is_faint = match.gain < LEAST_CONTRAST_SHARE * self.gain
        return (match.power > self.most_power(match.gain)) | is_faint

    def foreign(self, rows: np.ndarray, values: Array) -> np.ndarray:
        """Which pixels (n, m) of rows (n, 11, m) show something else, in the light of most corners
        or in each one's own, by its match `values` (n, 6): in the one that explains more."""
        own = values[:, _VALUE:].astype(np.float32)
        is_faint = own[:, 0] < LEAST_CONTRAST_SHARE * self.gain
        usual = np.array([self.gain, self.level, 0.0, 0.0], np.float32)
        own = np.where(is_faint[:, None], usual, own)
        lights = np.stack([np.broadcast_to(usual, own.shape), own])
        drawn = (lights[:, :, None] @ rows[:, _VALUE : _Y + 1])[:, :, 0]
        beyond = np.abs(rows[:, _SEEN] - drawn) > FOREIGN_SHARE * np.abs(lights[:, :, :1])
        best = np.argmin(np.count_nonzero(beyond, axis=2), axis=0)
        return beyond[best, np.arange(len(rows))]


def _clear(match: _Match, usual: Usual, patches: Patches) -> np.ndarray:
    """Which corners (n,) the picture shows as they are printed."""
    total = patches.weight.sum(axis=1)
    least_gain = max(LEAST_CONTRAST_SHARE * usual.gain, LEAST_CONTRAST)
    drawn = match.gain**2 * match.variance
    return (
        (match.count > np.maximum(LEAST_SHOWN * total, LEAST_PIXELS))
        & (match.gain > least_gain)
        & (match.power < np.maximum(usual.most_power(match.gain), SCRATCHED_SHARE * drawn))
        & (match.power < NOISE_POWER + MOST_UNEXPLAINED * drawn)
    )


def _blur_change(match: _Match, clear: np.ndarray, *, with_response: bool) -> Array:
    """The change of blur (4,) that all clear corners together ask for."""
    change = np.zeros(4)
    gain = np.where(clear, match.gain, 0.0)
    normal = np.einsum("n,nij->ij", gain * gain, match.left[:, :4, :4])
    right = gain @ match.left[:, :4, 4]
    normal += np.diag(1e-3 * np.diag(normal) + 1e-9)
    asked = 4 if with_response else 3
    change[:asked] = np.linalg.solve(normal[:asked, :asked], right[:asked])
    return change
