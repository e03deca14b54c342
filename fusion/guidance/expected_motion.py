"""How uncertain a robot will be that goes from one pose to another by odometry.

It turns towards the goal, drives there, and turns. The contract's random walk gives, with L the
path and H a turn, rotation variances of turn²·H at the start, which the whole way levers into
place, and of drive²·L evenly along it: with a the arm from start to goal, the integral over the way
is [a]× V [a]×ᵀ / 3 of place, -[a]× V / 2 between place and rotation, and V of rotation.
"""

import numpy as np

from trigpoint.fusion.solver.snapshot import ExpectedMotion, RobotPlace
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array, hat

_FLOOR_VARIANCE = 1e-13


def expected_motion(place: RobotPlace, start: Pose, goal: Pose, path_m: float) -> ExpectedMotion:
    """From one map_from_base to another; `path_m`: how long the way is, at least the distance."""
    noise = place.noise
    arm = goal.translation - start.translation
    bearing = np.arctan2(arm[1], arm[0])
    first = _wrapped(bearing - float(start.heading)) if np.linalg.norm(arm[:2]) > 1e-6 else 0.0
    net = _wrapped(float(goal.heading) - float(start.heading))
    last = _wrapped(net - first)
    turning = np.array([noise.tilt_turn, noise.tilt_turn, noise.heading_turn]) ** 2
    driving = np.array([noise.tilt, noise.tilt, noise.heading_drive]) ** 2 * path_m
    lever = hat(arm)
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = _translation(place, bearing, path_m, abs(first) + abs(last))
    at_start = turning * abs(first)
    covariance[:3, :3] += lever @ np.diag(at_start + driving / 3) @ lever.T
    covariance[:3, 3:] = -lever @ np.diag(at_start + driving / 2)
    covariance[3:, :3] = covariance[:3, 3:].T
    covariance[3:, 3:] = np.diag(at_start + driving + turning * abs(last))
    by_start = np.eye(6)
    by_start[:3, 3:] = -lever
    by_scale = np.zeros((6, 2))
    by_scale[:3, 0] = arm
    by_scale[:3, 1] = np.array([-arm[1], arm[0], 0.0]) * first
    by_scale[5, 1] = first + last
    free = np.ix_(place.tangent, place.tangent)
    floor = _FLOOR_VARIANCE * np.eye(len(place.tangent))
    return ExpectedMotion(by_start[free], by_scale[place.tangent], covariance[free] + floor)


def _translation(place: RobotPlace, bearing: float, path_m: float, turned: float) -> Array:
    noise = place.noise
    along = np.array([np.cos(bearing), np.sin(bearing), 0.0])
    aside = np.array([-np.sin(bearing), np.cos(bearing), 0.0])
    slip = np.diag([1.0, 1.0, 0.0]) * place.slip**2 * turned
    walk = noise.distance**2 * np.outer(along, along) + noise.lateral**2 * np.outer(aside, aside)
    walk[2, 2] += noise.vertical**2
    return walk * path_m + slip


def _wrapped(angle: float) -> float:
    return float(np.arctan2(np.sin(angle), np.cos(angle)))
