"""The uncertainty of a robot that drives from one pose to another by odometry.

It turns towards the goal, drives there, and turns. The contract's random walk gives, with L the
path and H a turn, rotation variances of turn²·H at the start, which the whole way levers into
place, and of drive²·L evenly along it: with a the arm from start to goal, the integral over the way
is [a]× V [a]×ᵀ / 3 of place, -[a]× V / 2 between place and rotation, and V of rotation.
"""

import numpy as np

from trigpoint.contract.odometry_noise import step_variances
from trigpoint.fusion.model.motion import FLOOR_VARIANCE
from trigpoint.fusion.solver.snapshot import ExpectedMotion, RobotPlace
from trigpoint.geometry import Pose
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.uncertainty import lever


def expected_motion(place: RobotPlace, start: Pose, goal: Pose, path_m: float) -> ExpectedMotion:
    """The motion from one map_from_base to another; `path_m`: its length, at least the distance."""
    noise = place.noise
    arm = goal.translation - start.translation
    bearing = np.arctan2(arm[1], arm[0])
    is_elsewhere = np.linalg.norm(arm[:2]) > 1e-6
    first = float(so3.wrap(bearing - start.heading)) if is_elsewhere else 0.0
    net = float(so3.wrap(goal.heading - start.heading))
    last = float(so3.wrap(net - first))
    driving = step_variances(noise, path_m, 0.0)
    at_start, at_end = step_variances(noise, 0.0, np.abs([first, last])).rotation
    by_start = lever(arm)
    swing = by_start[:3, 3:]
    covariance = np.zeros((6, 6))
    middle = so3.about_z(bearing)
    covariance[:3, :3] = (middle * driving.translation) @ middle.T
    slip = place.slip**2 * (abs(first) + abs(last))
    covariance[:3, :3] += np.diag([slip, slip, 0.0])
    covariance[:3, :3] += swing @ np.diag(at_start + driving.rotation / 3) @ swing.T
    covariance[:3, 3:] = swing @ np.diag(at_start + driving.rotation / 2)
    covariance[3:, :3] = covariance[:3, 3:].T
    covariance[3:, 3:] = np.diag(at_start + driving.rotation + at_end)
    by_scale = np.zeros((6, 2))
    by_scale[:3, 0] = arm
    by_scale[:3, 1] = np.array([-arm[1], arm[0], 0.0]) * first
    by_scale[5, 1] = first + last
    free = np.ix_(place.tangent, place.tangent)
    floor = FLOOR_VARIANCE * np.eye(len(place.tangent))
    return ExpectedMotion(by_start[free], by_scale[place.tangent], covariance[free] + floor)
