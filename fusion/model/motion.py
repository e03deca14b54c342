"""Motion composed of many small steps, with its covariance and its derivative by the scales."""

from dataclasses import dataclass

import numpy as np

from trigpoint.geometry import Pose
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import lever, turned_axes

UNKNOWN_VARIANCE = 100.0**2
STILL = 1e-9
# 0.3 µm and µrad a step: keeps the information of a tiny motion finite.
FLOOR_VARIANCE = 1e-13
# The non-zero elements of the covariance of a motion in the plane, upper triangle.
_PLANE_ROWS = [0, 0, 1, 2, 0, 1, 2, 2, 3, 4, 5]
_PLANE_COLUMNS = [0, 1, 1, 2, 5, 5, 3, 4, 3, 4, 5]


@dataclass(frozen=True, slots=True)
class Motion:
    """Motion between consecutive moments; leading dimension n.

    `earlier_from_later`: the scaled reported motion; `covariance`: (n, 6, 6) of its disturbance in
    the earlier frame's axes; `by_scale`: (n, 6, 2), derivative of that disturbance by the distance
    and heading scale errors; `is_still`: (n,) whether the robot did not move at all.
    """

    earlier_from_later: Pose
    covariance: Array
    by_scale: Array
    is_still: np.ndarray

    def where(self, chosen: np.ndarray) -> "Motion":
        """The motions selected by a mask (n,) bool."""
        return Motion(
            self.earlier_from_later[chosen],
            self.covariance[chosen],
            self.by_scale[chosen],
            self.is_still[chosen],
        )


@dataclass(frozen=True, slots=True)
class OdometryStep:
    """A robot's pose after one odometry step; leading dimensions as its pose has.

    `end`: that pose. Its disturbance is `by_start` (…, 6, 6) times the start's, `by_motion`
    (…, 6, 6) times the motion's, and `by_scales` (…, 6, 2) times a change of the scales.
    """

    end: Pose
    by_start: Array
    by_motion: Array
    by_scales: Array


def odometry_step(start: Pose, motion: Motion) -> OdometryStep:
    """Apply one motion to a start pose: t' = t + R Δt, R' = R ΔR. A rotation of the start swings
    the end about it."""
    end = start @ motion.earlier_from_later[0]
    by_motion = turned_axes(start.rotation)
    by_start = lever(end.translation - start.translation)
    return OdometryStep(end, by_start, by_motion, by_motion @ motion.by_scale[0])


@dataclass(frozen=True, slots=True)
class StepNoise:
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


def moved(twists: Array) -> Pose:
    """The motion of constant twists (n, 6) over a unit of time."""
    turns = twists[:, 3:]
    shifts = (so3.left_jacobian(turns) @ twists[:, :3, None])[..., 0]
    return Pose(so3.exp(turns), shifts)


def twist_of(motion: Pose) -> Array:
    """The constant twists (…, 6) of motions (…) over a unit of time: the inverse of `moved`."""
    turns = so3.log(motion.rotation)
    shifts = np.linalg.solve(so3.left_jacobian(turns), motion.translation[..., None])[..., 0]
    return np.concatenate([shifts, turns], axis=-1)


def both(scale: Array) -> Array:
    """Expand factors (2,) of distance and heading to the six components of a twist."""
    return np.repeat(scale, 3)


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
    return Motion(whole, total, by_scale, _is_still(twists, noise, starts))


def composed_in_plane(
    twists: Array, noise: StepNoise, segment: np.ndarray, scales: Array
) -> Motion:
    """`composed_motion` of twists within the plane: the same sums, written in terms of headings,
    which takes a tenth of the time."""
    ends = np.cumsum(np.bincount(segment))
    starts = np.concatenate([[0], ends[:-1]])
    turn = twists[:, 5] * (1 + scales[1])
    speed = (twists[:, 0] + 1j * twists[:, 1]) * (1 + scales[0])  # the plane's x + iy
    step = speed * _mean_direction(turn)
    heading = np.concatenate([[0.0], np.cumsum(turn)])
    place = np.concatenate([[0.0], np.cumsum(step * np.exp(1j * heading[:-1]))])
    back = np.exp(-1j * heading[starts])
    whole = (place[ends] - place[starts]) * back
    frame = np.exp(1j * (heading[:-1] - heading[starts][segment]))
    ahead = (place[ends][segment] - place[1:]) * back[segment]
    total = _covariance_in_plane(noise, frame * np.exp(0.5j * twists[:, 5]), ahead, starts)
    bend = (speed * np.exp(1j * turn) - step) / (1 + scales[1])
    shift = np.add.reduceat(frame * bend + 1j * ahead * twists[:, 5], starts)
    by_scale = np.zeros((len(starts), 6, 2))
    x, y = _parts(whole)
    by_scale[:, 0, 0], by_scale[:, 1, 0] = x / (1 + scales[0]), y / (1 + scales[0])
    by_scale[:, 0, 1], by_scale[:, 1, 1] = _parts(shift)
    by_scale[:, 5, 1] = np.add.reduceat(twists[:, 5], starts)
    pose = Pose.planar(x, y, heading[ends] - heading[starts])
    return Motion(pose, total, by_scale, _is_still(twists, noise, starts))


def _parts(number: np.ndarray) -> tuple[Array, Array]:
    return np.real(number), np.imag(number)


def _mean_direction(turn: Array) -> np.ndarray:
    """The mean of e^(iθ) for θ from 0 to each turn: the direction of a step as a whole."""
    small = np.abs(turn) < 1e-4
    safe = np.where(small, 1.0, turn)
    sine = np.where(small, 1 - turn**2 / 6, np.sin(safe) / safe)
    versine = np.where(small, turn / 2, (1 - np.cos(safe)) / safe)
    return sine + 1j * versine


def _covariance_in_plane(
    noise: StepNoise, middle: Array, ahead: Array, starts: np.ndarray
) -> Array:
    """The segments' covariance (n, 6, 6). `middle` (m,): a step's axes half-way through it; `ahead`
    (m,): from its end to the segment's end; both as x + iy in its segment's frame. A tilt lifts
    what lies ahead, a heading error swings it."""
    unknown = np.where(noise.is_unknown, UNKNOWN_VARIANCE, 0.0)
    along, aside, above = np.where(noise.is_unknown, 0.0, noise.along.T)
    slip = np.where(noise.is_unknown, UNKNOWN_VARIANCE, noise.slip)
    tilt = np.where(noise.is_unknown, UNKNOWN_VARIANCE, noise.tilt)
    heading = np.where(noise.is_unknown, UNKNOWN_VARIANCE, noise.heading)
    cosine, sine, x, y = middle.real, middle.imag, ahead.real, ahead.imag
    entries = np.array(
        [
            along * cosine**2 + aside * sine**2 + slip + heading * y**2,
            (along - aside) * cosine * sine - heading * x * y,
            along * sine**2 + aside * cosine**2 + slip + heading * x**2,
            above + unknown + tilt * (x**2 + y**2),
            -heading * y,
            heading * x,
            tilt * y,
            -tilt * x,
            tilt,
            tilt,
            heading,
        ]
    )
    sums = np.add.reduceat(entries, starts, axis=1).T
    total = np.zeros((len(starts), 6, 6))
    total[:, _PLANE_ROWS, _PLANE_COLUMNS] = total[:, _PLANE_COLUMNS, _PLANE_ROWS] = sums
    return total + FLOOR_VARIANCE * np.eye(6)


def _is_still(twists: Array, noise: StepNoise, starts: np.ndarray) -> np.ndarray:
    """Whether the robot did not move at all in each segment."""
    most = np.maximum.reduceat(np.abs(twists).max(axis=1), starts)
    return (most < STILL) & ~np.logical_or.reduceat(noise.is_unknown, starts)


def composed(steps: Pose) -> Pose:
    """Poses after 0, 1, … n steps, by a doubling scan over the rotations."""
    rotations = steps.rotation.copy()
    reach = 1
    while reach < len(rotations):
        rotations[reach:] = rotations[:-reach] @ rotations[reach:]
        reach *= 2
    frames = np.concatenate([np.eye(3)[None], rotations])
    moved_by = (frames[:-1] @ steps.translation[..., None])[..., 0]
    return Pose(frames, np.concatenate([np.zeros((1, 3)), np.cumsum(moved_by, axis=0)]))
