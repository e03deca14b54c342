"""The increment between two odometry messages, taken as a motion with a constant twist."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from trigpoint.geometry import Pose

from .motion import twist_of


class Increment(NamedTuple):
    """Length (m), angle (rad), and twist: translation, rotation vector, in the base's axes."""

    length_m: float
    angle_rad: float
    twist: Sequence[float]


def increment(before: Pose, after: Pose) -> Increment:
    """The increment from one pose to the next, in space."""
    step = before.inverse() @ after
    twist = twist_of(step)
    length, angle = np.linalg.norm(step.translation), np.linalg.norm(twist[3:])
    return Increment(float(length), float(angle), twist.tolist())


def planar_increment(before: Pose, after: Pose) -> Increment:
    """The same in the plane: t = V v, V = [a -b; b a], a = sin θ/θ, b = (1 - cos θ)/θ.

    With plain floats, which are quicker for one step.
    """
    (cosine, _, _), (sine, _, _), _ = before.rotation.tolist()
    (forward, _, _), (left, _, _), _ = after.rotation.tolist()
    here, there = before.translation.tolist(), after.translation.tolist()
    dx, dy = there[0] - here[0], there[1] - here[1]
    x, y = cosine * dx + sine * dy, cosine * dy - sine * dx
    turn = math.atan2(cosine * left - sine * forward, cosine * forward + sine * left)
    a, b = 1.0 - turn**2 / 6, turn / 2
    if abs(turn) > 1e-4:
        a, b = math.sin(turn) / turn, (1 - math.cos(turn)) / turn
    square = a * a + b * b
    twist = ((a * x + b * y) / square, (a * y - b * x) / square, 0.0, 0.0, 0.0, turn)
    return Increment(math.hypot(x, y), abs(turn), twist)


def in_plane(pose: Pose) -> Pose:
    """The pose projected into the plane: position and heading; with plain floats too."""
    forward, left = pose.rotation.item(0), pose.rotation.item(3)
    length = math.hypot(forward, left)
    cosine, sine = (forward / length, left / length) if length else (1.0, 0.0)
    rotation = np.array((cosine, -sine, 0.0, sine, cosine, 0.0, 0.0, 0.0, 1.0)).reshape(3, 3)
    x, y, _ = pose.translation.tolist()
    return Pose(rotation, np.array((x, y, 0.0)))
