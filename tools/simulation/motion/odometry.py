"""The odometry that a simulated robot reports of its true way."""

import numpy as np
from msgspec import Struct, field

from trigpoint.contract.odometry_noise import step_variances
from trigpoint.geometry import Pose
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
