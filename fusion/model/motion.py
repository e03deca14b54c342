"""Motion composed of many small steps, with its covariance and its derivative by the scales."""

import numpy as np
from msgspec import Struct

from trigpoint.geometry import Pose
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import lever, turned_axes

STILL = 1e-9
# 0.3 µm and µrad: keeps the information of a tiny motion finite.
FLOOR_VARIANCE = 1e-13


class Motion(Struct, frozen=True):
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


class OdometryStep(Struct, frozen=True):
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


def moved(twists: Array) -> Pose:
    """The motion of constant twists (n, 6) over a unit of time."""
    turns = twists[:, 3:]
    shifts = (so3.left_jacobian(turns) @ twists[:, :3, None])[..., 0]
    return Pose(so3.exp(turns), shifts)


def both(scale: Array) -> Array:
    """Expand factors (2,) of distance and heading to the six components of a twist."""
    return np.repeat(scale, 3)


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
