"""How a step of the believed pose reaches the robot: at once, or spread over time."""

import math

import numpy as np

from trigpoint.base.clock import to_seconds
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.robot.odometry.interpolation import between
from trigpoint.robot.odometry.odometry import Stamped

from .sent_covariance import as_sent


class Blend:
    """`span_s`: the time constant with which a step is phased in; 0: at once. Not thread-safe."""

    def __init__(self, span_s: float) -> None:
        self._span_s = span_s
        self._told: tuple[Stamped, Pose] | None = None

    def restart(self) -> None:
        """Send the next pose as it is."""
        self._told = None

    def told(
        self, at: Stamped, map_from_base: Pose, covariance: Array, *, establishes: bool = False
    ) -> tuple[Pose, Array]:
        """The pose to send to the robot, and its covariance (6, 6) as sent, which includes the part
        held back; a pose that establishes is sent as it is."""
        if self._told is None or establishes or self._span_s == 0:
            self._told = (at, map_from_base)
            return map_from_base, as_sent(covariance)
        before, told = self._told
        expected = told @ (before.odom_from_base.inverse() @ at.odom_from_base)
        elapsed_s = max(0.0, to_seconds(at.stamp_ns - before.stamp_ns))
        pose = between(expected, map_from_base, 1 - math.exp(-elapsed_s / self._span_s))
        self._told = (at, pose)
        held_back = map_from_base.difference(pose)
        return pose, as_sent(covariance + np.outer(held_back, held_back))
