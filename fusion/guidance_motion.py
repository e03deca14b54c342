"""How uncertain a robot will be that goes from one pose to another by odometry.

It turns towards the goal, drives there, and turns. The contract's random walk gives, with L the
path and H a turn, rotation variances of turn²·H at the start, which the whole way levers into
place, and of drive²·L evenly along it: with a the arm from start to goal, the integral over the way
is [a]× V [a]×ᵀ / 3 of place, -[a]× V / 2 between place and rotation, and V of rotation.
"""

from dataclasses import dataclass

import numpy as np

from trigpoint.config import OdometryNoise
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array, hat
from trigpoint.target import Target

from .dataset import DataSet
from .filter import Filter
from .odometry_track import PLANAR, SPATIAL, Motion

_FLOOR_VARIANCE = 1e-13


@dataclass(frozen=True, slots=True)
class ExpectedMotion:
    """In the free disturbances (d) of the robot: of the end by those of the start (d, d), by the
    scale errors of distance and heading (d, 2), and the covariance (d, d) that the way adds."""

    by_start: Array
    by_scale: Array
    covariance: Array


@dataclass(frozen=True, slots=True)
class RobotPlace:
    """A robot where its odometry has it now, and what it is like.

    `since`: the motion since the filter's last pose of it.
    """

    robot: str
    stamp_ns: int
    map_from_base: Pose
    since: ExpectedMotion
    noise: OdometryNoise
    slip: float
    planar: bool
    target: Target

    @property
    def tangent(self) -> list[int]:
        return PLANAR if self.planar else SPATIAL


def place_of(data: DataSet, known: Filter, robot: str) -> RobotPlace:
    """Where a robot is by its last odometry message."""
    track, start_ns = data.tracks[robot], known.stamps_ns[robot]
    pose = known.state.robots[robot].map_from_base[0]
    still = np.eye(len(track.tangent))
    since = ExpectedMotion(still, np.zeros((len(still), 2)), 0.0 * still)
    if start_ns < track.last_ns:
        motion = track.motion(np.array([start_ns, track.last_ns]), known.scales(robot))
        since = _since(motion, pose, track.tangent)
        pose = pose @ motion.earlier_from_later[0]
    return RobotPlace(
        robot,
        track.last_ns,
        pose,
        since,
        track.noise,
        track.slip,
        track.planar,
        data.targets[robot],
    )


def _since(motion: Motion, start: Pose, tangent: list[int]) -> ExpectedMotion:
    """The motion's disturbance, which is in the axes of its start, in those of the map."""
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = start.rotation
    by_start = np.eye(6)
    by_start[:3, 3:] = -hat(start.rotation @ motion.earlier_from_later[0].translation)
    free = np.ix_(tangent, tangent)
    return ExpectedMotion(
        by_start[free],
        (turn @ motion.by_scale[0])[tangent],
        (turn @ motion.covariance[0] @ turn.T)[free],
    )


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
