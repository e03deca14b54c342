"""Motion between moments of a robot's odometry, written out with numpy; the core is held to it."""

import numpy as np
from msgspec import Struct

from trigpoint.contract.odometry_noise import step_variances
from trigpoint.fusion.model.motion import FLOOR_VARIANCE, STILL, Motion, both, composed, moved
from trigpoint.fusion.model.odometry import OdometryTrack
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import lever, turned_axes

UNKNOWN_VARIANCE = 100.0**2
_GAP_RADIUS_M = 0.5


class StepNoise(Struct, frozen=True):
    """Variances of steps (n): `along` (n, 3) of the translation in the axes half-way through the
    step, `slip` (n,) in addition along x and y, `tilt` and `heading` (n,); where `is_unknown` (n,),
    all of them are `UNKNOWN_VARIANCE` instead."""

    along: Array
    slip: Array
    tilt: Array
    heading: Array
    is_unknown: np.ndarray

    def covariance(self, half_turns: Array) -> Array:
        """(n, 6, 6) in the axes of the frame that each step starts from; `half_turns`: (n, 3)."""
        middle = so3.exp(half_turns)
        covariance = np.zeros((len(self.slip), 6, 6))
        covariance[:, :3, :3] = (middle * self.along[:, None]) @ np.swapaxes(middle, 1, 2)
        covariance[:, 0, 0] += self.slip
        covariance[:, 1, 1] += self.slip
        covariance[:, [3, 4], [3, 4]] = self.tilt[:, None]
        covariance[:, 5, 5] = self.heading
        covariance[self.is_unknown] = UNKNOWN_VARIANCE * np.eye(6)
        return covariance


def slow_motion(track: OdometryTrack, stamps_ns: np.ndarray, scales: Array) -> Motion:
    """`OdometryTrack.motion`."""
    first = max(int(np.searchsorted(track.stamps_ns, stamps_ns[0], "right")) - 1, 0)
    last = int(np.searchsorted(track.stamps_ns, stamps_ns[-1], "left"))
    fine = np.concatenate([stamps_ns, track.stamps_ns[first + 1 : last]])
    order = np.argsort(fine, kind="stable")
    fine = fine[order]
    # Row of the odometry message that ends the increment in which each fine step lies.
    rows = np.clip(np.searchsorted(track.stamps_ns, fine[1:], "left"), 1, len(track) - 1)
    part = np.diff(fine) / (track.stamps_ns[rows] - track.stamps_ns[rows - 1])
    segment = np.cumsum(order < len(stamps_ns))[:-1] - 1
    twists = track._twists[rows] * part[:, None]
    return composed_motion(twists, _step_noise(track, rows, part), segment, scales)


def _step_noise(track: OdometryTrack, rows: np.ndarray, part: Array) -> StepNoise:
    """The noise of each fine step, which is a part (n,) of the increment that ends at a row."""
    twists = track._twists[rows]
    length = np.linalg.norm(twists[:, :3], axis=1) * part
    turned = np.linalg.norm(twists[:, 3:], axis=1) * part
    unseen = track._gaps[rows] * part
    length = np.maximum(length, unseen)
    turned = np.maximum(turned, unseen / _GAP_RADIUS_M)
    stated = step_variances(track.noise, length, turned)
    return StepNoise(
        along=stated.translation + turned[:, None] * np.array([track.skid**2, 0.0, 0.0]),
        slip=track.slip**2 * turned,
        tilt=stated.rotation[:, 0],
        heading=stated.rotation[:, 2],
        # The step before a moment that coincides with a message has no length, and says nothing of
        # a jump.
        is_unknown=track._jumps[rows] & (part > 0),
    )


def composed_motion(twists: Array, noise: StepNoise, segment: np.ndarray, scales: Array) -> Motion:
    """Compose steps (m) of unscaled twists (m, 6) into one motion for each segment; `segment` (m,):
    which one a step belongs to, ascending and without gaps."""
    ends = np.cumsum(np.bincount(segment))
    starts = np.concatenate([[0], ends[:-1]])
    scaled = twists * both(1 + scales)
    steps = moved(scaled)
    path = composed(steps)
    begin, end = path[starts], path[ends]
    whole = begin.inverse() @ end
    # Each step's frame, and the way from its end to its segment's, in the axes of that one's start.
    start_rotation = np.swapaxes(begin.rotation[segment], 1, 2)
    frame = start_rotation @ path.rotation[:-1]
    ahead = end.translation[segment] - path.translation[1:]
    spread = lever((start_rotation @ ahead[..., None])[..., 0]) @ turned_axes(frame)
    covariance = spread @ noise.covariance(0.5 * twists[:, 3:]) @ np.swapaxes(spread, 1, 2)
    total = np.add.reduceat(covariance, starts, axis=0) + FLOOR_VARIANCE * np.eye(6)
    # d(k J_l(kθ) v)/dk = Exp(kθ) v, so a step's own translation J_l(kθ) v bends with its turn.
    bend = (steps.rotation @ scaled[:, :3, None])[..., 0] - steps.translation
    by_turn = np.concatenate([bend / (1 + scales[1]), twists[:, 3:]], axis=1)
    turning = spread @ by_turn[..., None]
    by_scale = np.zeros((len(starts), 6, 2))
    by_scale[:, :3, 0] = whole.translation / (1 + scales[0])
    by_scale[:, :, 1] = np.add.reduceat(turning[..., 0], starts, axis=0)
    return Motion(whole, total, by_scale, is_still(twists, noise, starts))


def is_still(twists: Array, noise: StepNoise, starts: np.ndarray) -> np.ndarray:
    """Whether the robot did not move at all in each segment."""
    most = np.maximum.reduceat(np.abs(twists).max(axis=1), starts)
    return (most < STILL) & ~np.logical_or.reduceat(noise.is_unknown, starts)
