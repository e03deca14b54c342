"""Differential drive: motion from the counters of two wheels.

Counters wrap at some number of bits; between two readings a wheel turns by less than half of that
range, so the difference nearest to zero is the true one. A step is an arc: both wheels turn
evenly.
"""

import math

import numpy as np
from msgspec import Struct

from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.site.config import WheelConfig


class WheelGeometry(Struct, frozen=True):
    """`left_m`, `right_m`: metres per count; `track_m`: between the wheels' contact points; `bits`:
    width of the counters, at which they wrap."""

    left_m: float
    right_m: float
    track_m: float
    bits: int


def wheel_geometry(
    config: WheelConfig,
    bits: int,
    *,
    diameter_m: float = 0.0,
    track_m: float = 0.0,
    ticks: float = 0.0,
) -> WheelGeometry | None:
    """Geometry from the site file, or from the robot's own numbers if that has none; None if
    neither is complete."""
    diameter, track = config.diameter or diameter_m, config.track or track_m
    counts = config.ticks or ticks
    if not (diameter and track and counts):
        return None
    metres = math.pi * diameter / counts
    return WheelGeometry(metres * config.left_scale, metres * config.right_scale, track, bits)


class WheelOdometry:
    """Adds up one robot's steps, starting at the origin. Not thread-safe."""

    def __init__(self) -> None:
        self._counts: tuple[int, int] | None = None
        self._stamp_ns = 0
        self._x = self._y = self._heading = 0.0

    def add(
        self, left: int, right: int, geometry: WheelGeometry, stamp_ns: int
    ) -> tuple[Pose, Array, Array]:
        """(odom_from_base, linear, angular speed) after a reading of both counters."""
        before, self._counts = self._counts, (left, right)
        elapsed_s = (stamp_ns - self._stamp_ns) / 1e9
        self._stamp_ns = stamp_ns
        if before is None:
            return self.add_way(0.0, 0.0, geometry.track_m, 0.0)
        left_m = geometry.left_m * nearest(left - before[0], geometry.bits)
        right_m = geometry.right_m * nearest(right - before[1], geometry.bits)
        return self.add_way(left_m, right_m, geometry.track_m, elapsed_s)

    def add_way(
        self, left_m: float, right_m: float, track_m: float, elapsed_s: float
    ) -> tuple[Pose, Array, Array]:
        """The same from the distances that the wheels travelled."""
        way, turn = 0.5 * (left_m + right_m), (right_m - left_m) / track_m
        middle = self._heading + 0.5 * turn
        # The chord of the arc; np.sinc is sin(πx)/(πx).
        chord = way * float(np.sinc(0.5 * turn / math.pi))
        self._x += chord * math.cos(middle)
        self._y += chord * math.sin(middle)
        self._heading = math.remainder(self._heading + turn, 2 * math.pi)
        linear, angular = np.zeros(3), np.zeros(3)
        if elapsed_s > 0:
            linear[0], angular[2] = way / elapsed_s, turn / elapsed_s
        return Pose.planar(self._x, self._y, self._heading), linear, angular


def nearest(difference: float, bits: int) -> float:
    """The difference nearest to zero of two counters that wrap."""
    half = 1 << (bits - 1)
    return (difference + half) % (1 << bits) - half
