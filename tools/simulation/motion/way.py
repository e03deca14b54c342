"""A robot's true way about what it reports, by the letter of the contract's noise model.

`odometry.reported` draws the report about a smooth truth, which suits a lab whose pictures are to
be the same for every seed. An estimator takes the contract at its word: it has the truth scatter
about the report. The two differ where the way between two messages matters: a rough report about a
smooth truth seems to tell when a picture was taken, and does not.
"""

import numpy as np
from msgspec import Struct
from numpy.typing import ArrayLike

from trigpoint.contract.odometry_noise import step_variances
from trigpoint.geometry import Pose
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.rotation import Array
from trigpoint.site.config import OdometryNoise

from .odometry import half_turned


def poses_at(stamps: np.ndarray, poses: Pose, moments: np.ndarray) -> Pose:
    """Poses at moments (…) between those (n) of a way at `stamps` (n,), in its unit: from the one
    before, the same share of the step's translation and turn; the nearest one beyond its ends."""
    rows = np.clip(np.searchsorted(stamps, moments, "right") - 1, 0, len(stamps) - 2)
    gap = stamps[rows + 1] - stamps[rows]
    share = np.clip((moments - stamps[rows]) / gap, 0.0, 1.0)
    before = poses[rows]
    return before.disturbed(poses[rows + 1].difference(before) * share[..., None])


class Way(Struct, frozen=True, eq=False):
    """True poses `map_from_base` (n) at moments `stamps_s` (n,) that hold every odometry message
    and every picture, and the scale errors (2,) that the report has."""

    stamps_s: Array
    map_from_base: Pose
    scale_errors: Array

    def at(self, t_s: ArrayLike) -> Pose:
        """The pose at world times (…): exact at the stamps, the same share of a step's motion in
        between, held at both ends."""
        return poses_at(self.stamps_s, self.map_from_base, np.asarray(t_s, dtype=float))


def scattered(
    steps: Array, noise: OdometryNoise, scale_errors: Array, random: np.random.Generator
) -> Array:
    """True motion (n, 3) x, y, heading of reported `steps` (n, 3), each in the frame it starts
    from: the report with its scale errors and the contract's independent noise."""
    clean = steps * (1 + scale_errors[[0, 0, 1]])
    variances = step_variances(noise, np.hypot(steps[:, 0], steps[:, 1]), np.abs(steps[:, 2]))
    draw = random.standard_normal(steps.shape)
    shift = half_turned(np.sqrt(variances.translation[:, :2]) * draw[:, :2], steps[:, 2])
    return clean + np.column_stack([shift, np.sqrt(variances.rotation[:, 2]) * draw[:, 2]])


def scattered_in_space(
    steps: Pose, noise: OdometryNoise, scale_errors: Array, random: np.random.Generator
) -> Pose:
    """`scattered` of steps (n) in space, with the contract's noise in all directions."""
    turns = so3.log(steps.rotation)
    moves = np.linalg.solve(so3.left_jacobian(turns), steps.translation[..., None])[..., 0]
    variances = step_variances(noise, np.linalg.norm(moves, axis=1), np.linalg.norm(turns, axis=1))
    draw = random.standard_normal((len(turns), 6))
    shift = np.sqrt(variances.translation) * draw[:, :3]
    shift = (so3.exp(0.5 * turns) @ shift[..., None])[..., 0]
    turns, moves = turns * (1 + scale_errors[1]), moves * (1 + scale_errors[0])
    true = Pose(so3.exp(turns), (so3.left_jacobian(turns) @ moves[..., None])[..., 0])
    return true.disturbed(np.hstack([shift, np.sqrt(variances.rotation) * draw[:, 3:]]))


def chained_in_space(start: Pose, steps: Pose) -> Pose:
    """The poses (n + 1) that steps (n) lead to from `start`."""
    poses = [start]
    for step in range(len(steps)):
        poses.append(poses[-1] @ steps[step])
    return Pose.stack(poses)
