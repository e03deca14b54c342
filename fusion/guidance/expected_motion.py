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
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import lever


def expected_motion(place: RobotPlace, start: Pose, goals: Pose, path_m: Array) -> ExpectedMotion:
    """The motions from one map_from_base to others (…); `path_m` (…): their lengths, at least the
    distance."""
    noise = place.noise
    arm = goals.translation - start.translation
    bearing = np.arctan2(arm[..., 1], arm[..., 0])
    is_elsewhere = np.linalg.norm(arm[..., :2], axis=-1) > 1e-6
    first = np.where(is_elsewhere, so3.wrap(bearing - start.heading), 0.0)
    last = so3.wrap(so3.wrap(goals.heading - start.heading) - first)
    driving = step_variances(noise, path_m, 0.0)
    at_start = step_variances(noise, 0.0, np.abs(first)).rotation
    at_end = step_variances(noise, 0.0, np.abs(last)).rotation
    by_start = lever(arm)
    swing = by_start[..., :3, 3:]
    covariance = np.zeros((*first.shape, 6, 6))
    middle = so3.about_z(bearing)
    covariance[..., :3, :3] = (middle * driving.translation[..., None, :]) @ np.swapaxes(
        middle, -1, -2
    )
    slip = place.slip**2 * (np.abs(first) + np.abs(last))
    covariance[..., [0, 1], [0, 1]] += slip[..., None]
    swung = swing * (at_start + driving.rotation / 3)[..., None, :]
    covariance[..., :3, :3] += swung @ np.swapaxes(swing, -1, -2)
    covariance[..., :3, 3:] = swing * (at_start + driving.rotation / 2)[..., None, :]
    covariance[..., 3:, :3] = np.swapaxes(covariance[..., :3, 3:], -1, -2)
    covariance[..., [3, 4, 5], [3, 4, 5]] = at_start + driving.rotation + at_end
    by_scale = np.zeros((*first.shape, 6, 2))
    by_scale[..., :3, 0] = arm
    by_scale[..., 0, 1], by_scale[..., 1, 1] = -arm[..., 1] * first, arm[..., 0] * first
    by_scale[..., 5, 1] = first + last
    rows, columns = np.ix_(place.tangent, place.tangent)
    return ExpectedMotion(
        by_start[..., rows, columns],
        by_scale[..., place.tangent, :],
        covariance[..., rows, columns] + FLOOR_VARIANCE * np.eye(len(rows)),
    )
