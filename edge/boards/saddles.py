"""Finds the X-shaped corners of checkerboards in a picture, cheaply and in bounded time.

Such a corner is a saddle of brightness: the determinant of the Hessian of the smoothed picture is
strongly negative there. On a ring around it brightness goes light, dark, light, dark, so that the
ring's even harmonics hold nearly all of its power (after the idea of Bennett and Lasenby, «ChESS»,
2014); edges, blobs, T and L junctions do not pass.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from trigpoint.edge.image.sampling import sampled
from trigpoint.edge.image.workspace import Workspace
from trigpoint.geometry.rotation import Array

from .tuning import TUNING

_BEND = np.array([[1, -2, 1]], np.float32)
_SLOPE = np.array([-0.5, 0, 0.5], np.float32)
_AROUND = np.ones((5, 5), np.uint8)
_RING_ANGLES = np.arange(TUNING.ring_samples) * (2 * np.pi / TUNING.ring_samples)
_RING = TUNING.ring_radius_px * np.stack([np.cos(_RING_ANGLES), np.sin(_RING_ANGLES)], axis=-1)
# Of a ring, cosine and sine amplitudes of harmonics 1 to 8, columns; and which of their squares
# make up the power of all, of the odd ones, and of the second.
_WAVES = np.arange(1, TUNING.ring_samples // 2 + 1)
_HARMONICS = np.hstack(
    [np.cos(np.outer(_RING_ANGLES, _WAVES)), np.sin(np.outer(_RING_ANGLES, _WAVES))]
).astype(np.float32) / np.float32(TUNING.ring_samples)
_POWERS = np.tile(
    np.stack([np.ones(len(_WAVES)), _WAVES % 2 == 1, _WAVES == 2], axis=-1), (2, 1)
).astype(np.float32)


@dataclass(frozen=True, slots=True)
class Saddles:
    """X corners of one picture, strongest first.

    `pixels`: (n, 2); `directions`: (n, 4) angles of the four edges that leave the corner, rising
    (from x towards y), so that the sector from direction 0 to 1 is light, from 1 to 2 dark and so
    on; `amplitude`: (n,) half the difference between light and dark, grey levels.
    """

    pixels: Array
    directions: Array
    amplitude: Array

    def __len__(self) -> int:
        return len(self.pixels)


@dataclass(frozen=True, slots=True, eq=False)
class Curvature:
    """A smoothed picture and its second derivatives, (height, width) float32 each, which lie in
    `space`: they last until it is used for the next picture."""

    smooth: np.ndarray
    xx: np.ndarray
    yy: np.ndarray
    xy: np.ndarray
    space: Workspace

    @classmethod
    def of(cls, grey: np.ndarray, space: Workspace | None = None) -> "Curvature":
        """Smooth and differentiate a grey picture, (height, width) uint8."""
        space = space or Workspace()
        smooth, xx, yy, xy = (
            space.array(name, grey.shape) for name in ("smooth", "xx", "yy", "xy")
        )
        blurred = space.array("blurred", grey.shape, np.uint8)
        np.copyto(smooth, cv2.GaussianBlur(grey, (0, 0), TUNING.smoothing_px, dst=blurred))
        cv2.filter2D(smooth, cv2.CV_32F, _BEND, dst=xx)
        cv2.filter2D(smooth, cv2.CV_32F, _BEND.T, dst=yy)
        cv2.sepFilter2D(smooth, cv2.CV_32F, _SLOPE, _SLOPE, dst=xy)
        return cls(smooth, xx, yy, xy, space)


def find_saddles(curvature: Curvature) -> Saddles:
    """All X corners of a picture, the strongest where there are too many."""
    return examine(curvature, _candidates(curvature))


def examine(curvature: Curvature, pixels: Array, *, tolerance: float = 1.0) -> Saddles:
    """The X corners among `pixels` (n, 2), moved to the saddle of the smoothed picture.

    `tolerance` above 1 lets weaker ones pass, where it is known that one should be there.
    """
    pixels = _settled(curvature, pixels)
    # The cheaper questions first: of a room's candidates they leave a third.
    pixels = pixels[_bends_both_ways(curvature, pixels)]
    rings = ring_brightness(curvature.smooth, pixels)
    amplitude, passes = _judge(rings, tolerance)
    pixels, rings, amplitude = pixels[passes], rings[passes], amplitude[passes]
    directions, has_four_edges = _edge_directions(rings, sampled(curvature.smooth, pixels))
    kept = np.flatnonzero(has_four_edges)
    kept = kept[np.argsort(-amplitude[kept], kind="stable")[: TUNING.most_saddles]]
    return Saddles(pixels[kept], directions[kept], amplitude[kept])


def ring_brightness(smooth: np.ndarray, pixels: Array) -> Array:
    """Brightness on the ring around each pixel, (n, samples)."""
    return sampled(smooth, pixels[:, None, :] + _RING)


def _candidates(curvature: Curvature) -> Array:
    """Local maxima of the saddle strength, (n, 2); the strongest where there are many."""
    xx, yy, xy, space = curvature.xx, curvature.yy, curvature.xy, curvature.space
    strength, peaks = space.array("strength", xx.shape), space.array("peaks", xx.shape)
    strong, is_peak = (space.array(name, xx.shape, np.uint8) for name in ("strong", "is_peak"))
    # The determinant, negative; `peaks` serves twice.
    cv2.multiply(xy, xy, dst=strength)
    cv2.subtract(strength, cv2.multiply(xx, yy, dst=peaks), dst=strength)
    cv2.dilate(strength, _AROUND, dst=peaks)
    np.greater(strength, TUNING.least_strength**2, out=strong)
    cv2.bitwise_and(strong, cv2.compare(strength, peaks, cv2.CMP_GE, dst=is_peak), dst=strong)
    margin = int(np.ceil(TUNING.ring_radius_px))
    strong[:margin] = strong[-margin:] = 0
    strong[:, :margin] = strong[:, -margin:] = 0
    places = cv2.findNonZero(strong)
    if places is None:
        return np.zeros((0, 2))
    places = np.asarray(places, dtype=np.intp).reshape(-1, 2)
    if len(places) > TUNING.most_candidates:
        strengths = strength[places[:, 1], places[:, 0]]
        places = places[
            np.argpartition(-strengths, TUNING.most_candidates)[: TUNING.most_candidates]
        ]
    return places.astype(float)


def _settled(curvature: Curvature, pixels: Array) -> Array:
    """One Newton step to the saddle point, of at most 1.5 px."""
    height, width = curvature.smooth.shape
    x = np.clip(np.rint(pixels[:, 0]).astype(int), 1, width - 2)
    y = np.clip(np.rint(pixels[:, 1]).astype(int), 1, height - 2)
    smooth = curvature.smooth
    gradient = 0.5 * np.stack(
        [smooth[y, x + 1] - smooth[y, x - 1], smooth[y + 1, x] - smooth[y - 1, x]], axis=-1
    )
    xx, yy, xy = curvature.xx[y, x], curvature.yy[y, x], curvature.xy[y, x]
    determinant = xx * yy - xy * xy
    safe = np.where(determinant < -1e-6, determinant, -1e-6)
    step = -np.stack(
        [yy * gradient[:, 0] - xy * gradient[:, 1], xx * gradient[:, 1] - xy * gradient[:, 0]],
        axis=-1,
    )
    step = step / safe[:, None]
    length = np.linalg.norm(step, axis=-1)
    step *= np.minimum(1.0, 1.5 / np.maximum(length, 1e-9))[:, None]
    return np.stack([x, y], axis=-1) + step.astype(float)


def _judge(rings: Array, tolerance: float) -> tuple[Array, np.ndarray]:
    """Half the light-dark difference of each ring (n,), and whether it is that of an X corner."""
    parts = rings.astype(np.float32) @ _HARMONICS
    total, odd, second = (parts * parts @ _POWERS).astype(float).T
    total = total + 1e-9
    amplitude = 2 * np.sqrt(second)
    passes = (
        (amplitude * tolerance > TUNING.least_ring_amplitude)
        & (odd < tolerance * TUNING.most_odd_power * total)
        & (second * tolerance > TUNING.least_second_harmonic * total)
    )
    return amplitude, passes


def _bends_both_ways(curvature: Curvature, pixels: Array) -> np.ndarray:
    """Whether brightness bends up along one axis and clearly down along the other; (n,) bool."""
    x, y = np.rint(pixels).astype(int).T
    height, width = curvature.smooth.shape
    at = (np.clip(y, 0, height - 1), np.clip(x, 0, width - 1))
    mean = 0.5 * (curvature.xx[at] + curvature.yy[at])
    radius = np.hypot(0.5 * (curvature.xx[at] - curvature.yy[at]), curvature.xy[at])
    up, down = mean + radius, radius - mean
    return (up > TUNING.least_curvature_ratio * down) & (down > TUNING.least_curvature_ratio * up)


def _edge_directions(rings: Array, levels: Array) -> tuple[Array, np.ndarray]:
    """The four rising edge angles of each corner (n, 4), and whether it has just four (n,).

    An edge is where the ring, averaged with itself half a turn on, crosses the corner's own level
    (n,). The Hessian would tell the angles too, but where squares are small the next ones bend it
    by up to 30 degrees.
    """
    half = TUNING.ring_samples // 2
    above = 0.5 * (rings[:, :half] + rings[:, half:]) - levels[:, None]
    following = np.roll(above, -1, axis=1)
    rising = (above <= 0) & (following > 0)
    falling = (above > 0) & (following <= 0)
    has_four = (rising.sum(axis=1) == 1) & (falling.sum(axis=1) == 1)
    light, dark = _crossing(rising, above, following), _crossing(falling, above, following)
    dark = np.where(dark < light, dark + np.pi, dark)
    return np.stack([light, dark, light + np.pi, dark + np.pi], axis=-1), has_four


def _crossing(crosses: np.ndarray, above: Array, following: Array) -> Array:
    """Angle in [0, π) at which each ring crosses its level, interpolated; (n,)."""
    index = np.argmax(crosses, axis=1)
    rows = np.arange(len(above))
    before, after = above[rows, index], following[rows, index]
    difference = before - after
    part = np.where(np.abs(difference) > 1e-9, before / np.where(difference, difference, 1.0), 0)
    return (index + np.clip(part, 0, 1)) * (2 * np.pi / TUNING.ring_samples)
