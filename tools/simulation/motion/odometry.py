"""The odometry that a simulated robot reports of its true way, or its true way about a report.

`reported` draws the report about a smooth truth, which suits a lab whose pictures are to be the
same for every seed. An estimator takes the contract at its word: it has the truth scatter about the
report, as `scattered` draws it. The two differ where the way between two messages matters: a rough
report about a smooth truth seems to tell when a picture was taken, and does not.
"""

import numpy as np
from msgspec import Struct, field
from numpy.typing import ArrayLike

from trigpoint.contract.odometry_noise import step_variances
from trigpoint.geometry import Pose
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.rotation import Array, about_z, wrap
from trigpoint.site.config import OdometryNoise


class OdometryLog(Struct, frozen=True, eq=False):
    """Every message: `stamps_s` (n,) world time, `poses` (n) odom_from_base; and the true scale
    errors (2,) of distance and heading that are in them."""

    stamps_s: Array
    poses: Pose
    scale_errors: Array = field(default_factory=lambda: np.zeros(2))


def increments(poses: Pose) -> Array:
    """Motion from pose to pose in the frame of the earlier one; (n - 1, 3) x, y, heading."""
    return relative(poses[:-1], poses[1:])


def relative(earlier: Pose, later: Pose) -> Array:
    """Motion between poses (n) in the frame of the earlier one; (n, 3) x, y, heading."""
    steps = earlier.inverse() @ later
    return np.column_stack([steps.translation[:, :2], steps.heading])


def chained(start: Pose, steps: Array) -> Pose:
    """The poses (n + 1) that `steps` (n, 3) lead to from `start`; the inverse of `increments`."""
    headings = start.heading + np.concatenate([[0.0], np.cumsum(steps[:, 2])])
    cosine, sine = np.cos(headings[:-1]), np.sin(headings[:-1])
    moves = np.column_stack(
        [cosine * steps[:, 0] - sine * steps[:, 1], sine * steps[:, 0] + cosine * steps[:, 1]]
    )
    positions = start.translation[:2] + np.vstack([np.zeros(2), np.cumsum(moves, axis=0)])
    return Pose.planar(positions[:, 0], positions[:, 1], wrap(headings))


def drawn_scales(noise: OdometryNoise, random: np.random.Generator) -> Array:
    """Scale errors (2,) of distance and heading, drawn from their prior."""
    return random.standard_normal(2) * [noise.distance_scale, noise.heading_scale]


def reported(
    truth: Array, noise: OdometryNoise, scale_errors: Array, random: np.random.Generator
) -> Array:
    """The increments (n, 3) that a robot reports of its true ones, by the contract's noise model.

    The model speaks of the truth given the report: truth = (1 + scale error) × report + noise, with
    variances from the report's length L and turn H. Here the truth comes first, so the report is
    truth minus noise, over 1 + scale error. L and H are the means over both signs of the noise of
    what would be reported: as reported itself, they would depend on the noise's sign and give it a
    mean (k²/2 a step), which the model does not have. So the variances agree but for the square of
    one step's relative noise, a percent or so.
    """
    scale = 1 + scale_errors
    clean = truth / [scale[0], scale[0], scale[1]]
    draw = random.standard_normal(truth.shape)
    driven = step_variances(noise, np.hypot(clean[:, 0], clean[:, 1]), 0.0)
    drive = np.sqrt(driven.rotation[:, 2])
    turned = _heading_noise(drive, noise.heading_turn, clean[:, 2], draw[:, 2])
    shift = half_turned(np.sqrt(driven.translation[:, :2]) * draw[:, :2], clean[:, 2])
    return (truth - np.column_stack([shift, turned])) / [scale[0], scale[0], scale[1]]


def half_turned(shifts: Array, turns: Array) -> Array:
    """Shifts (n, 2) along and across the direction half-way through turns (n,), in the axes that
    the steps start from."""
    return (about_z(turns / 2)[:, :2, :2] @ shifts[..., None])[..., 0]


def _heading_noise(drive: Array, per_root_turn: float, turn: Array, draw: Array) -> Array:
    """Noise w of variance drive² + per_root_turn² · H, for the mean H of |turn - w| and |turn + w|,
    which is the greater one of |turn| and |w|; all (n,), radians. `draw`: standard normal."""
    small = draw * np.sqrt(drive**2 + per_root_turn**2 * np.abs(turn))
    # Where |w| is the greater one, it solves w² = (drive² + k² |w|) draw².
    half = 0.5 * (per_root_turn * draw) ** 2
    large = half + np.sqrt(half**2 + (drive * draw) ** 2)
    return np.where(np.abs(small) <= np.abs(turn), small, np.copysign(large, draw))


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
